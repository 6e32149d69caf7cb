//! Determines how far the robot reaches from the middle of its base, and the resulting speed of its outermost point.
//!
//! While the base moves with the twist (v, ω), a point at (x, y) in the base's frame moves with the velocity (v − ωy, ωx).
//! In a turn, its speed is therefore the turn rate times its distance from the axis of the turn.
//! The points are those of the body, the arm, the tool and a held object, seen from above.

use host_robot::{DVec2, JOINTS, Joints, Twist};

use super::collision::{Part, World};
use crate::things::Things;

/// A disc that covers a part of the robot seen from above, in the base's frame.
#[derive(Clone, Copy, Debug)]
struct Disc {
    part: Part,
    middle_m: DVec2,
    radius_m: f64,
}

/// The point of the robot that is fastest while the base moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outermost {
    /// The part that contains the point.
    pub part: Part,
    /// Its speed in m/s.
    pub speed_m_s: f64,
    /// Its distance from the middle of the base, in m.
    pub from_middle_m: f64,
}

/// The parts of the robot seen from above.
#[derive(Clone, Debug)]
pub struct Reach(Vec<Disc>);

impl World {
    /// Returns the reach of the body alone.
    pub fn reach_of_body(&self) -> Reach {
        let body = self.scene().base.body();
        let corners = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
        let corners = corners.map(|(x, y)| Disc {
            part: Part::Base,
            middle_m: body.center_m.truncate() + DVec2::new(x, y) * body.half_m.truncate(),
            radius_m: 0.0,
        });
        Reach(corners.into())
    }

    /// Returns the reach of body, arm, tool and held object.
    pub fn reach(&self, joints_rad: &Joints, things: &Things) -> Reach {
        let mut reach = self.reach_of_body();
        let mount_m = self.scene().base.mount_m;
        let shapes = self.shapes(&self.arm().link_poses(joints_rad), &self.on_flange(things));
        reach.0.extend(shapes.all().flat_map(|(link, shape)| {
            [shape.a_m, shape.b_m].map(|end_m| Disc {
                part: self.part(link),
                middle_m: (mount_m + end_m).truncate(),
                radius_m: shape.radius_m,
            })
        }));
        reach
    }

    /// Returns the maximum displacement of any point of the arm if its joints move this far.
    pub fn displacement_m(&self, ways_rad: &Joints) -> f64 {
        (0..JOINTS).map(|i| ways_rad[i].abs() * self.lever_m()[i]).sum()
    }
}

impl Reach {
    /// Returns the fastest point. Parts of the arm may be up to `off_m` away from their place.
    pub fn outermost(&self, twist: Twist, off_m: f64) -> Option<Outermost> {
        let Twist { linear_m_s, angular_rad_s } = twist;
        let speed = |disc: &Disc| {
            let off_m = if disc.part == Part::Base { 0.0 } else { off_m };
            let radius_m = disc.radius_m + off_m;
            let along =
                DVec2::new(linear_m_s - angular_rad_s * disc.middle_m.y, angular_rad_s * disc.middle_m.x);
            Outermost {
                part: disc.part,
                speed_m_s: along.length() + angular_rad_s.abs() * radius_m,
                from_middle_m: disc.middle_m.length() + radius_m,
            }
        };
        self.0.iter().map(speed).max_by(|a, b| a.speed_m_s.total_cmp(&b.speed_m_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::SerialArm;
    use crate::scene::Scene;

    fn world(scene: &str) -> World {
        World::new(SerialArm::gen3(), Scene::parse(scene).unwrap())
    }

    fn stretched() -> Joints {
        let mut joints_rad = [0.0; JOINTS];
        joints_rad[1] = std::f64::consts::FRAC_PI_2;
        joints_rad
    }

    #[test]
    fn a_turn_moves_the_outermost_point_by_the_turn_rate_times_its_distance() {
        let world = world("");
        let turn = Twist { linear_m_s: 0.0, angular_rad_s: 0.5 };
        let upright = world.reach(&[0.0; JOINTS], world.start()).outermost(turn, 0.0).unwrap();
        // The corners of the body are at (0.3, 0.25).
        assert_eq!(upright.part, Part::Base);
        assert!((upright.speed_m_s - 0.5 * 0.3_f64.hypot(0.25)).abs() < 1e-12, "{upright:?}");
        let stretched = world.reach(&stretched(), world.start()).outermost(turn, 0.0).unwrap();
        // The flange is 0.9 m from the shoulder, the shoulder 0.1 m ahead of the middle.
        assert!((0.95..1.1).contains(&stretched.from_middle_m), "{stretched:?}");
        assert!((stretched.speed_m_s - 0.5 * stretched.from_middle_m).abs() < 1e-12);
        let doubted = world.reach(&self::stretched(), world.start()).outermost(turn, 0.1).unwrap();
        assert!((doubted.speed_m_s - stretched.speed_m_s - 0.05).abs() < 1e-12);
    }

    #[test]
    fn straight_ahead_all_points_are_as_fast_as_the_base_and_a_tool_reaches_further() {
        let bare = world("");
        let ahead = Twist { linear_m_s: -0.7, angular_rad_s: 0.0 };
        let all = bare.reach(&stretched(), bare.start()).outermost(ahead, 0.3).unwrap();
        assert!((all.speed_m_s - 0.7).abs() < 1e-12);
        let with_hand = world("[[tool]]\nname = \"2f-85\"\n");
        let arc = Twist { linear_m_s: 0.3, angular_rad_s: 0.4 };
        let fastest = |world: &World| world.reach(&stretched(), world.start()).outermost(arc, 0.0).unwrap();
        assert!(matches!(fastest(&with_hand).part, Part::Fingers | Part::Tool));
        let longer_m = fastest(&with_hand).from_middle_m - fastest(&bare).from_middle_m;
        assert!((0.1..0.2).contains(&longer_m), "{longer_m}");
    }
}
