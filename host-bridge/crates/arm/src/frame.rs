//! Frames of a motion's steps: with a frame, a step goes to an object instead of a fixed place.
//!
//! ```toml
//! # Above an object of the scene, at the object's current position:
//! { position_m = [0, 0, 0.25], quaternion_wxyz = [0, 1, 0, 0], frame = "cup" }
//! # Above an object whose pose is published on a topic (geometry_msgs/PoseStamped):
//! { position_m = [0, 0, 0.25], quaternion_wxyz = [0, 1, 0, 0], frame = "/cup_pose", age_max_s = 0.5 }
//! ```
//!
//! Position and orientation of the tool's point are then relative to the object's own frame.
//! The origin of a scene object's frame is the middle of its underside, and the frame turns with the object.

use crate::motions::{MotionError, Motions, Step};

/// Default value for the maximum age of a pose on a topic.
const AGE_MAX_S: f64 = 0.5;
/// Permitted range of the maximum age. With an even older pose, the object would be a fixed place.
const AGES_S: std::ops::RangeInclusive<f64> = 0.05..=10.0;

/// The frame of a step.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Frame {
    /// An object of the scene.
    Object(String),
    /// A `geometry_msgs/PoseStamped` on a topic.
    Topic {
        /// The full name of the topic.
        name: String,
        /// Maximum age of the pose when the motion begins.
        age_max_ms: u64,
    },
}

impl Frame {
    /// Reads the frame of a step. A name with a slash at the start is a topic.
    pub(crate) fn read(name: &str, age_max_s: Option<f64>) -> Result<Self, String> {
        let Some(own) = name.strip_prefix('/') else {
            return match age_max_s {
                Some(_) => Err(format!("age_max_s belongs to a topic; '{name}' is an object of the scene")),
                None => Ok(Frame::Object(name.to_owned())),
            };
        };
        // The rules of ROS 2, which the node applies to all names.
        let is_word = |word: &str| {
            word.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_')
                && word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
                && !word.contains("__")
        };
        if !own.split('/').all(is_word) {
            return Err(format!("frame = \"{name}\" is no topic; topics are like \"/cup_pose\""));
        }
        let age_max_s = age_max_s.unwrap_or(AGE_MAX_S);
        if !AGES_S.contains(&age_max_s) {
            return Err(format!(
                "age_max_s = {age_max_s}: lies between {} and {} s",
                AGES_S.start(),
                AGES_S.end()
            ));
        }
        Ok(Frame::Topic { name: name.to_owned(), age_max_ms: (age_max_s * 1000.0).round() as u64 })
    }
}

impl Step {
    /// Returns the frame of this step, if it has one.
    pub(crate) fn frame(&self) -> Option<&Frame> {
        match self {
            Step::Tool { frame, .. } => frame.as_ref(),
            _ => None,
        }
    }
}

impl Motions {
    /// Checks that every object to which a step refers is in this list.
    ///
    /// # Errors
    /// Fails with [`MotionError::Step`], which contains the name of the missing object.
    pub fn check_objects(&self, objects: &[&str]) -> Result<(), MotionError> {
        for motion in self.all() {
            for (i, step) in motion.steps.iter().enumerate() {
                if let Some(Frame::Object(name)) = step.frame()
                    && !objects.contains(&name.as_str())
                {
                    let known = if objects.is_empty() { "none".to_owned() } else { objects.join(", ") };
                    let reason = format!(
                        "the scene has no object '{name}' (it has: {known}); add [[object]], or name a topic such as \
                         \"/{name}\""
                    );
                    return Err(MotionError::Step { motion: motion.name.to_string(), step: i + 1, reason });
                }
            }
        }
        Ok(())
    }

    /// Returns the topics on which steps depend, without duplicates.
    pub fn topics(&self) -> Vec<String> {
        let steps = self.all().iter().flat_map(|motion| &motion.steps);
        let mut topics: Vec<String> = steps
            .filter_map(|step| match step.frame() {
                Some(Frame::Topic { name, .. }) => Some(name.clone()),
                _ => None,
            })
            .collect();
        topics.sort();
        topics.dedup();
        topics
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::SerialArm;
    use crate::motions::MotionTable;

    fn read(step: &str) -> Result<Motions, MotionError> {
        let table: MotionTable = toml::from_str(&format!("name = \"own\"\nsteps = [{step}]")).unwrap();
        Motions::new(&SerialArm::gen3(), &[], &[], &[table])
    }

    fn place(more: &str) -> String {
        format!("{{ position_m = [0, 0, 0.2], quaternion_wxyz = [0, 1, 0, 0], {more} }}")
    }

    #[test]
    fn objects_and_topics_are_read_and_told_apart_by_a_slash() {
        let motions = read(&place("frame = \"/desk/cup_pose\", age_max_s = 0.3")).unwrap();
        let frame = Frame::Topic { name: "/desk/cup_pose".to_owned(), age_max_ms: 300 };
        assert!(
            matches!(&motions.get("own").unwrap().steps[0], Step::Tool { frame: Some(f), .. } if *f == frame)
        );
        assert_eq!(motions.topics(), ["/desk/cup_pose"]);
        assert!(motions.check_objects(&[]).is_ok());

        let motions = read(&place("frame = \"cup\"")).unwrap();
        assert!(motions.topics().is_empty() && motions.check_objects(&["bowl", "cup"]).is_ok());
        let told = motions.check_objects(&["bowl"]).unwrap_err().to_string();
        assert!(
            told.contains("no object 'cup'") && told.contains("bowl") && told.contains("\"/cup\""),
            "{told}"
        );
    }

    #[test]
    fn frames_that_make_no_sense_are_refused_with_the_reason() {
        for (step, told) in [
            (place("frame = \"cup\", age_max_s = 1"), "belongs to a topic"),
            (place("frame = \"/cup pose\""), "is no topic"),
            (place("frame = \"/\""), "is no topic"),
            (place("frame = \"/cup\", age_max_s = 60"), "between 0.05 and 10 s"),
            (place("frame = \"/cup\", age_max_s = nan"), "between 0.05 and 10 s"),
            (place("age_max_s = 1"), "a frame that is a topic"),
            ("{ move_m = [0, 0, 0.1], frame = \"cup\" }".to_owned(), "belongs to position_m"),
            ("{ to = \"home\", frame = \"cup\" }".to_owned(), "belongs to position_m"),
        ] {
            let error = read(&step).unwrap_err().to_string();
            assert!(error.contains(told) && error.contains("step 1"), "{error}");
        }
    }
}
