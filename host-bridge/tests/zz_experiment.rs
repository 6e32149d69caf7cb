#[path = "support/wrist.rs"]
mod wrist;
use models::synth::{IdleKind, Motion, Segment, Wearer, session};

fn rows(w: &Wearer, take: u64, script: &[Segment]) -> Vec<[f64; 9]> {
    session(w, take, script).samples().map(|s| std::array::from_fn(|i| f64::from(s[i]))).collect()
}
fn hops(rows: &[[f64; 9]], offset: usize) -> Vec<[f64; 3]> {
    rows[offset..].chunks_exact(8).map(|c| wrist::mean_mm_s2(c).map(|v| v / 1000.0)).collect()
}
fn dist(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}
fn mean(m: &[[f64; 3]]) -> [f64; 3] {
    std::array::from_fn(|i| m.iter().map(|v| v[i]).sum::<f64>() / m.len() as f64)
}
fn size(a: [f64; 3]) -> f64 {
    dist(a, [0.0; 3])
}
const NAMES: [&str; 6] = ["A last", "B max3", "C size-8", "D var4", "E mean4", "F max(2..4)"];
fn stat(m: &[[f64; 3]], h: usize) -> [f64; 6] {
    let a = dist(m[h], m[h - 1]);
    let b = (1..=3).map(|k| dist(m[h], m[h - k])).fold(0.0, f64::max);
    let c = (size(m[h]) - m[h - 8..h].iter().map(|v| size(*v)).sum::<f64>() / 8.0).abs();
    let four = &m[h - 3..=h];
    let mu = mean(four);
    let d = (four.iter().map(|v| dist(*v, mu).powi(2)).sum::<f64>() / 4.0).sqrt();
    let e = dist(m[h], mean(&m[h - 4..h]));
    let f = dist(m[h], mean(&m[h - 5..h - 1]));
    [a, b, c, d, e, f]
}
#[test]
fn experiment() {
    let ths = [0.5, 0.7, 1.0, 1.3, 1.6, 2.0, 2.5];
    let mut delays: Vec<Vec<Vec<f64>>> = vec![vec![vec![]; ths.len()]; 6];
    let mut falses = vec![vec![0; ths.len()]; 6];
    let mut worst = vec![vec![(0.0, String::new()); ths.len()]; 6];
    for w in 1..=60u32 {
        let wearer = Wearer::evaluation(31, w);
        for (g, gesture) in Motion::GESTURES.into_iter().enumerate() {
            let phase = (w as usize * 7 + g * 3) % 8;
            let script = [Segment::new(Motion::IDLE, 6.0), Segment::new(gesture, 2.5), Segment::new(Motion::IDLE, 1.0)];
            let r: Vec<_> = rows(&wearer, g as u64, &script).into_iter().map(|v| wrist::tilted(v, [25.0, 0.0])).collect();
            let m = hops(&r, phase);
            for s in 0..6 {
                for (t, th) in ths.iter().enumerate() {
                    for h in 8..m.len() {
                        let end = phase + 8 * (h + 1);
                        if stat(&m, h)[s] > *th {
                            if end <= 600 { falses[s][t] += 1; continue; }
                            let d = (end as f64 - 600.0) * 10.0;
                            delays[s][t].push(d);
                            if d > worst[s][t].0 { worst[s][t] = (d, format!("{} {:?}", wearer.name, gesture)); }
                            break;
                        }
                    }
                }
            }
        }
    }
    for s in 0..6 {
        for (t, th) in ths.iter().enumerate() {
            let d = &mut delays[s][t];
            d.sort_by(f64::total_cmp);
            let q = |p: f64| d[((d.len() - 1) as f64 * p) as usize];
            println!("{:<12} {th:.1}: n {} median {:.0} p90 {:.0} p98 {:.0} worst {:.0} {} false {}", NAMES[s], d.len(), q(0.5), q(0.9), q(0.98), q(1.0), worst[s][t].1, falses[s][t]);
        }
    }
    println!("share of hops in %, per idle kind, thresholds {ths:?}");
    for kind in [IdleKind::Still, IdleKind::Fidget, IdleKind::Walk, IdleKind::Reach, IdleKind::Talk, IdleKind::Stroll, IdleKind::Lift] {
        let mut n = 0;
        let mut c = vec![vec![0; ths.len()]; 6];
        for w in 1..=20u32 {
            let wearer = Wearer::evaluation(31, w);
            let script = [Segment::new(Motion::Idle(kind), 20.0), Segment::new(Motion::Circle, 1.0)];
            let m = hops(&rows(&wearer, 50, &script)[..2000], 0);
            for h in 8..m.len() {
                n += 1;
                let st = stat(&m, h);
                for s in 0..6 { for (t, th) in ths.iter().enumerate() { c[s][t] += usize::from(st[s] > *th); } }
            }
        }
        for s in 0..6 {
            let line: Vec<String> = c[s].iter().map(|k| format!("{:5.1}", 100.0 * *k as f64 / n as f64)).collect();
            println!("{kind:?} {:<12} {}", NAMES[s], line.join(" "));
        }
    }
    for rate in [20.0, 30.0, 40.0, 60.0, 90.0, 150.0] {
        let r: Vec<[f64; 9]> = (0..300).map(|n| {
            let deg = 18.0 + (rate * (n as f64 - 100.0) / 100.0).clamp(0.0, 20.0);
            wrist::tilted([0.0, 0.0, 9.8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [deg, 0.0])
        }).collect();
        let m = hops(&r, 3);
        let most: Vec<String> = (0..6).map(|s| format!("{:.2}", (8..m.len()).map(|h| stat(&m, h)[s]).fold(0.0, f64::max))).collect();
        println!("turn at {rate} deg/s: {}", most.join(" "));
    }
}
