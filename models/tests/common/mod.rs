//! Recordings that several tests use.

/// Recordings of three people who make circles (two axes in quadrature), swing along one axis, and rest.
/// The movements of `b` are slower and smaller.
pub fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (p, (person, pace, size)) in
        [("a", 1.2, 4.0), ("b", 0.8, 2.5), ("c", 1.0, 3.2)].into_iter().enumerate()
    {
        for (l, label) in ["circle", "leftright", "idle"].into_iter().enumerate() {
            std::fs::create_dir_all(folder.path().join(label)).unwrap();
            for take in 0..4 {
                let mut text = String::from("timestamp_ms,accX,accY,accZ\n");
                for n in 0..500 {
                    let t = n as f64 / 100.0;
                    let phase = std::f64::consts::TAU * pace * t + f64::from(take);
                    let noise = 0.05 * (37.0 * t + (p * 7 + l * 3) as f64).sin();
                    let (x, z) = match label {
                        "circle" => (size * phase.sin(), size * phase.cos()),
                        "leftright" => (size * phase.sin(), 0.0),
                        _ => (0.0, 0.0),
                    };
                    text += &format!("{},{:.4},{:.4},{:.4}\n", n * 10, x + noise, noise, 9.8 + z);
                }
                std::fs::write(folder.path().join(format!("{label}/{person}__{take}.csv")), text).unwrap();
            }
        }
    }
    folder
}
