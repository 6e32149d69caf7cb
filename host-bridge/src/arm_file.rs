//! Reads the file of an arm other than the Gen3, and the meshes that the file refers to (feature `urdf`).

use std::path::{Path, PathBuf};

use crate::scene::ArmTable;

/// A robot's meshes have a size of a few megabytes.
const MESH_MAX_BYTES: u64 = 200_000_000;

/// A URDF that needs no other files, and notes about this URDF for the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ArmFile {
    /// The URDF, in which capsules replace all meshes that could be read.
    pub text: String,
    /// Remarks for the user.
    pub notes: Vec<String>,
}

/// Reads the file to which a scene refers; relative paths start at the scene's file.
///
/// # Errors
/// Fails if the file cannot be read, is not a URDF, or has no such arm.
pub fn read(urdf: &Path, scene_file: &Path, table: &ArmTable) -> Result<ArmFile, String> {
    let file = beside(scene_file).join(urdf);
    let text = std::fs::read_to_string(&file).map_err(|error| error.to_string())?;
    alone(&text, Some(&file), scene_file, table)
}

/// Does the same for a description published by a robot, whose meshes have package paths.
///
/// # Errors
/// Fails for the same reasons as [`read`].
pub fn published(text: &str, scene_file: &Path, table: &ArmTable) -> Result<ArmFile, String> {
    alone(text, None, scene_file, table)
}

/// The folder at which a scene's relative paths start.
fn beside(scene_file: &Path) -> &Path {
    scene_file.parent().unwrap_or(Path::new(""))
}

fn alone(text: &str, file: Option<&Path>, scene_file: &Path, table: &ArmTable) -> Result<ArmFile, String> {
    let missing = crate::arm::urdf::Missing::of(table);
    let packages = with_ros(table.packages.iter().map(|folder| beside(scene_file).join(folder)));
    let places = Places { beside: file.and_then(Path::parent), packages: &packages };
    let alone = crate::arm::urdf_meshes::stand_alone(text, &missing, &|name| places.mesh(name));
    let alone = alone.map_err(|error| error.to_string())?;
    Ok(ArmFile { text: alone.text, notes: alone.notes })
}

/// The search begins with the folders that the scene lists. The folders where ROS stores its packages follow.
fn with_ros(packages: impl Iterator<Item = PathBuf>) -> Vec<PathBuf> {
    let of = |name: &str| std::env::var_os(name).unwrap_or_default();
    let prefixes = std::env::split_paths(&of("AMENT_PREFIX_PATH"))
        .map(|prefix| prefix.join("share"))
        .collect::<Vec<_>>();
    let older: Vec<PathBuf> = std::env::split_paths(&of("ROS_PACKAGE_PATH")).collect();
    packages.chain(prefixes).chain(older).collect()
}

/// The folders in which meshes are searched.
struct Places<'a> {
    /// The folder that contains the URDF.
    beside: Option<&'a Path>,
    /// Folders that contain packages, or are packages themselves.
    packages: &'a [PathBuf],
}

impl Places<'_> {
    fn mesh(&self, name: &str) -> Result<Vec<u8>, String> {
        let tried = self.of(name);
        let Some(file) = tried.iter().find(|file| file.is_file()) else {
            let mut folders: Vec<String> =
                tried.iter().take(4).map(|file| file.display().to_string()).collect();
            if folders.is_empty() {
                folders.push("no folder".to_owned());
            }
            return Err(format!(
                "it is not there (looked for {}); name the folder that holds its package as packages under [arm]",
                folders.join(", ")
            ));
        };
        let told = |error: std::io::Error| error.to_string();
        let bytes = std::fs::metadata(file).map_err(told)?.len();
        if bytes > MESH_MAX_BYTES {
            return Err(format!("its {bytes} bytes are too many"));
        }
        std::fs::read(file).map_err(told)
    }

    /// Returns all possible paths of a mesh with that name.
    fn of(&self, name: &str) -> Vec<PathBuf> {
        if let Some(path) = name.strip_prefix("file://") {
            return vec![PathBuf::from(path)];
        }
        let Some(named) = name.strip_prefix("package://").or_else(|| name.strip_prefix("model://")) else {
            let path = Path::new(name);
            return if path.is_absolute() {
                vec![path.to_owned()]
            } else {
                self.beside.map(|beside| beside.join(path)).into_iter().collect()
            };
        };
        let (package, path) = named.split_once('/').unwrap_or((named, ""));
        // The file may lie within its package.
        let around = self.beside.into_iter().flat_map(Path::ancestors);
        let mut places = Vec::new();
        for folder in self.packages.iter().map(PathBuf::as_path).chain(around) {
            places.push(folder.join(named));
            if folder.file_name().is_some_and(|own| own == package) {
                places.push(folder.join(path));
            }
        }
        places
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ARM: &str = r#"<robot name="r"><link name="a"><collision><geometry><mesh filename="package://desk/meshes/a.obj"/></geometry>
        </collision></link><link name="b"><collision><origin xyz="0 0 1" rpy="0.1 0.2 0.3"/><geometry>
        <mesh filename="b.obj" scale="0.001 0.001 0.001"/></geometry></collision></link>
        <joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"#;
    const BOX: &str = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.4\nv 0.1 0.1 0.4\n";

    #[test]
    fn meshes_are_found_in_the_package_around_the_file_and_beside_it_and_the_text_stands_alone() {
        let folder = tempfile::tempdir().unwrap();
        let package = folder.path().join("desk");
        std::fs::create_dir_all(package.join("meshes")).unwrap();
        std::fs::create_dir_all(package.join("urdf")).unwrap();
        std::fs::write(package.join("urdf/arm.urdf"), ARM).unwrap();
        std::fs::write(package.join("meshes/a.obj"), BOX).unwrap();
        std::fs::write(package.join("urdf/b.obj"), "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 400\n").unwrap();
        let table = ArmTable::default();
        let scene = package.join("urdf/scene.toml");
        let found = read(Path::new("arm.urdf"), &scene, &table).unwrap();
        assert!(found.notes[0].starts_with("2 meshes count"), "{:?}", found.notes);
        assert!(!found.text.contains(".obj"), "{}", found.text);
        let missing = crate::arm::urdf::Missing::of(&table);
        let arm = crate::arm::urdf::parse(&found.text, &missing).unwrap();
        assert!(arm.notes.is_empty(), "{:?}", arm.notes);
        // Reading the result a second time changes nothing.
        let again = published(&found.text, &scene, &table).unwrap();
        assert_eq!(again.text, found.text);

        // From another folder, the file is found only through the listed folder.
        let bare = published(&ARM.replace("b.obj", "package://desk/urdf/b.obj"), Path::new("x.toml"), &table)
            .unwrap();
        assert!(
            bare.notes
                .iter()
                .any(|note| note.contains("package://desk/meshes/a.obj")
                    && note.contains("packages under [arm]")),
            "{:?}",
            bare.notes
        );
        let table = ArmTable { packages: vec![folder.path().to_owned()], ..table };
        let named =
            published(&ARM.replace("b.obj", "package://desk/urdf/b.obj"), Path::new("x.toml"), &table)
                .unwrap();
        assert_eq!(named.text, found.text);
    }
}
