//! Reads the section `[ros2]` of a scene, which is the profile of a robot on its graph.
//! This module also writes a scene from the information on a graph.

use std::path::Path;

use crate::arm::model::SerialArm;
use crate::config::Config;
use crate::ros2::Ros2Config;
use crate::scene::Scene;

/// Copies the profile from a scene's file to the configuration. Values that the configuration sets have priority.
/// Returns the scene.
///
/// # Errors
/// Fails if the file cannot be read, or if a key or value of its `[ros2]` is invalid.
pub fn take(config: &mut Config, file: &Path) -> Result<Scene, String> {
    let about = |why: &dyn std::fmt::Display| format!("{}: {why}", file.display());
    let text = std::fs::read_to_string(file).map_err(|error| about(&error))?;
    let scene = Scene::parse(&text).map_err(|error| about(&error))?;
    config.ros2 = merged(&config.ros2, &scene.ros2).map_err(|why| about(&why))?;
    Ok(scene)
}

/// Applies a profile, except for values that the user has set.
fn merged(own: &Ros2Config, profile: &toml::Table) -> Result<Ros2Config, String> {
    let table = |config: &Ros2Config| toml::Table::try_from(config).map_err(|error| error.to_string());
    let (usual, mut all) = (table(&Ros2Config::default())?, table(own)?);
    for (key, value) in profile {
        let Some(default) = usual.get(key) else {
            return Err(format!(
                "[ros2] has no key '{key}'; `host-bridge run --print-config` shows all keys"
            ));
        };
        if all.get(key) == Some(default) {
            all.insert(key.clone(), value.clone());
        }
    }
    let merged: Ros2Config =
        all.try_into().map_err(|error: toml::de::Error| format!("[ros2]: {}", error.message()))?;
    merged.check()?;
    Ok(merged)
}

/// Returns the only controller, or the one that was requested.
///
/// # Errors
/// Fails if the choice is not unique. The error lists the controllers and a remedy.
pub fn only(controllers: &[String], asked: Option<&str>) -> Result<String, String> {
    match (controllers, asked) {
        (_, Some(asked)) => {
            let asked = absolute(asked);
            if controllers.contains(&asked) {
                return Ok(asked);
            }
            Err(format!(
                "{asked} has no follow_joint_trajectory action; on the graph: {}",
                listed(controllers)
            ))
        }
        ([one], None) => Ok(one.clone()),
        ([], None) => Err(
            "the robot's description is there, but no controller on the graph has a follow_joint_trajectory action: is the arm's \
             controller loaded and active?"
                .to_owned(),
        ),
        (several, None) => Err(format!(
            "several controllers follow trajectories: {}; name the arm's with --controller",
            several.join(", ")
        )),
    }
}

/// Returns a controller's name as it is on the graph.
pub fn absolute(name: &str) -> String {
    if name.starts_with('/') { name.to_owned() } else { format!("/{name}") }
}

/// Lists the controllers on a graph for users.
pub fn listed(controllers: &[String]) -> String {
    if controllers.is_empty() { "none".to_owned() } else { controllers.join(", ") }
}

/// Returns a complete scene for a robot on a graph, shorter than a page.
pub fn written(file: &Path, urdf: &Path, arm: &SerialArm, controller: &str) -> String {
    let names: Vec<String> = arm.joints.iter().map(|joint| format!("{:?}", joint.name)).collect();
    format!(
        "# Written by `host-bridge arm` from the robot's own graph. A pose of where the arm is now:\n\
         # host-bridge teach \"a name\" --scene {file}\n\
         title = {name:?}\n\n\
         [ros2]\narm_controller = {controller:?}\njoint_names = [{names}]\n\n\
         [arm]\nurdf = {urdf:?}\nroot = {root:?}\ntip = {tip:?}\n\
         acceleration_rad_s2 = 2.0     # of joints that have none in the description, before scaling\n\
         velocity_scaling = 0.1\nacceleration_scaling = 0.3\n\n\
         [base]\nmount_m = [0.0, 0.0, 0.8]     # the arm's root above the floor\n",
        file = file.display(),
        name = arm.name,
        names = names.join(", "),
        urdf = urdf.display().to_string(),
        root = arm.root_link,
        tip = arm.flange_link,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_profile_counts_where_the_configuration_says_nothing_else() {
        let profile =
            toml::from_str("arm_controller = \"arm\"\njoint_names = [\"a\", \"b\"]\nrate_hz = 20").unwrap();
        let own = Ros2Config { arm_controller: "mine".to_owned(), ..Ros2Config::default() };
        let both = merged(&own, &profile).unwrap();
        assert_eq!((both.arm_controller.as_str(), both.joint_names.len(), both.rate_hz), ("mine", 2, 20));
        assert_eq!(merged(&own, &toml::Table::new()).unwrap(), own);
    }

    #[test]
    fn keys_and_values_that_make_no_sense_are_named() {
        let told = |text: &str| merged(&Ros2Config::default(), &toml::from_str(text).unwrap()).unwrap_err();
        assert!(told("arm_controllers = \"arm\"").contains("'arm_controllers'"));
        assert!(told("rate_hz = \"fast\"").contains("[ros2]"));
        assert!(told("joint_names = []").contains("eight"));
    }

    #[test]
    fn the_bundled_profiles_can_be_used_and_fit_on_a_page() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots");
        let mut seen = 0;
        for entry in std::fs::read_dir(&folder).unwrap() {
            let file = entry.unwrap().path();
            let mut config = Config::default();
            take(&mut config, &file).unwrap();
            let text = std::fs::read_to_string(&file).unwrap();
            assert!(text.lines().count() <= 40, "{}", file.display());
            let scene = Scene::parse(&text).unwrap();
            // Every arm except the Gen3 needs a description.
            assert!(scene.arm.urdf.is_some() != file.ends_with("gen3.toml"), "{}", file.display());
            assert!((1..=7).contains(&config.ros2.joint_names.len()));
            seen += 1;
        }
        assert_eq!(seen, 6);
    }

    #[test]
    fn one_controller_is_taken_several_are_named_and_none_is_an_error() {
        let two = ["/arm_controller".to_owned(), "/torso_controller".to_owned()];
        assert_eq!(only(&two[..1], None).unwrap(), "/arm_controller");
        assert_eq!(only(&two, Some("torso_controller")).unwrap(), "/torso_controller");
        let told = only(&two, None).unwrap_err();
        assert!(
            told.contains("/arm_controller, /torso_controller") && told.contains("--controller"),
            "{told}"
        );
        assert!(only(&[], None).is_err() && only(&two, Some("leg")).is_err());
    }

    #[test]
    fn the_scene_that_is_written_can_be_read_and_names_all_that_was_found() {
        let text = written(
            Path::new("desk/gen3.toml"),
            Path::new("gen3.urdf"),
            &SerialArm::gen3(),
            "/arm_controller",
        );
        assert!(text.lines().count() <= 20, "{text}");
        let scene = Scene::parse(&text).unwrap();
        assert_eq!(scene.arm.urdf.as_deref(), Some(Path::new("gen3.urdf")));
        assert_eq!(scene.arm.root.as_deref(), Some("base_link"));
        assert_eq!(scene.ros2["joint_names"].as_array().unwrap().len(), 7);
    }
}
