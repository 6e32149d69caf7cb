//! Reads the points of meshes from STL (binary and text), OBJ and COLLADA files (feature `urdf`).
//!
//! Only the corners are read, because the enclosing shapes depend on nothing else.

use host_robot::DVec3;
use host_robot::shape::Point;

/// Meshes with more corners are refused.
const POINTS_MAX: usize = 3_000_000;
/// No link of a robot is larger than this: a larger mesh is in millimetres, and its scale is missing.
const EXTENT_MAX_M: f64 = 5.0;

/// Returns the corners of the mesh in a file with this name, scaled, in m.
///
/// # Errors
/// Returns the problem with the mesh, as a text for users.
pub fn points(name: &str, bytes: &[u8], scale: DVec3) -> Result<Vec<Point>, String> {
    let ending = name.rsplit('.').next().unwrap_or("").to_ascii_lowercase();
    let raw = match ending.as_str() {
        "stl" => stl(bytes)?,
        "obj" => words(bytes, "v")?,
        "dae" => crate::dae::points(bytes, POINTS_MAX)?,
        _ => return Err(format!("files that end in .{ending} are not read; STL, OBJ and DAE are")),
    };
    if raw.is_empty() {
        return Err("it has no corners".to_owned());
    }
    let points: Vec<Point> = raw.into_iter().map(|point| point * scale).collect();
    if points.iter().any(|point| !point.is_finite()) {
        return Err("it has corners that are no numbers".to_owned());
    }
    let least = points.iter().copied().reduce(DVec3::min).unwrap_or_default();
    let most = points.iter().copied().reduce(DVec3::max).unwrap_or_default();
    let extent_m = (most - least).max_element();
    if extent_m > EXTENT_MAX_M {
        return Err(format!(
            "it would be {extent_m:.0} m large; if its figures are millimetres, give it scale=\"0.001 0.001 0.001\""
        ));
    }
    Ok(points)
}

/// A binary file contains its number of triangles and has exactly the resulting length. It may begin like a text file.
fn stl(bytes: &[u8]) -> Result<Vec<Point>, String> {
    const HEAD: usize = 84;
    const TRIANGLE: usize = 50;
    let count = bytes.get(80..HEAD).and_then(|four| four.try_into().ok()).map(u32::from_le_bytes);
    let is_text = bytes.trim_ascii_start().starts_with(b"solid");
    match count.map(|count| count as usize) {
        Some(count) if bytes.len() == HEAD + count.saturating_mul(TRIANGLE) || !is_text => {
            if bytes.len() < HEAD + count.saturating_mul(TRIANGLE) {
                return Err(format!(
                    "its end is missing: {count} triangles take more than its {} bytes",
                    bytes.len()
                ));
            }
            if 3 * count > POINTS_MAX {
                return Err(format!("its {count} triangles are too many"));
            }
            let number =
                |four: &[u8]| four.try_into().map_or(f64::NAN, |four| f64::from(f32::from_le_bytes(four)));
            let corner =
                |twelve: &[u8]| DVec3::new(number(&twelve[..4]), number(&twelve[4..8]), number(&twelve[8..]));
            // Each triangle begins with its normal and ends with two bytes of attributes.
            let triangles = bytes[HEAD..].chunks_exact(TRIANGLE).take(count);
            Ok(triangles.flat_map(|triangle| triangle[12..48].chunks_exact(12).map(corner)).collect())
        }
        _ if is_text => words(bytes, "vertex"),
        _ => Err(format!("its {} bytes are no STL", bytes.len())),
    }
}

/// Reads three numbers after the first word of each line.
fn words(bytes: &[u8], first: &str) -> Result<Vec<Point>, String> {
    let text = String::from_utf8_lossy(bytes);
    let mut points = Vec::new();
    for (n, line) in text.lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        if words.next() != Some(first) {
            continue;
        }
        let mut number = || words.next().and_then(|word| word.parse::<f64>().ok());
        let (Some(x), Some(y), Some(z)) = (number(), number(), number()) else {
            return Err(format!("its line {} has not three numbers", n + 1));
        };
        if points.len() == POINTS_MAX {
            return Err(format!("its more than {POINTS_MAX} corners are too many"));
        }
        points.push(DVec3::new(x, y, z));
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const CORNERS: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.25, 0.125]];

    fn binary(head: &[u8]) -> Vec<u8> {
        let mut bytes = head.to_vec();
        bytes.resize(80, b' ');
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend([0; 12]);
        bytes.extend(CORNERS.iter().flatten().flat_map(|value| value.to_le_bytes()));
        bytes.extend([0; 2]);
        bytes
    }

    fn corners() -> Vec<Point> {
        CORNERS.iter().map(|corner| DVec3::from(corner.map(f64::from))).collect()
    }

    #[test]
    fn binary_and_text_stl_and_obj_have_the_same_corners() {
        let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.5 0 0\n  vertex 0 2.5e-1 0.125\nendloop\nendfacet\nendsolid a\n";
        let obj = "# a\nv 0 0 0\nvn 0 0 1\nv 0.5 0 0\nv 0 0.25 0.125 1.0\nf 1//1 2//1 3//1\n";
        for (name, bytes) in [
            ("a.stl", binary(b"exported")),
            // Some programs write binary files that begin like text files.
            ("a.STL", binary(b"solid exported")),
            ("a.stl", text.as_bytes().to_vec()),
            ("a.obj", obj.as_bytes().to_vec()),
        ] {
            assert_eq!(points(name, &bytes, DVec3::ONE), Ok(corners()), "{name}");
        }
        let scaled = points("a.stl", &binary(b""), DVec3::new(2.0, 1.0, -1.0)).unwrap();
        assert_eq!(scaled[2], DVec3::new(0.0, 0.25, -0.125));
    }

    #[test]
    fn what_cannot_be_read_is_said() {
        let told = |name: &str, bytes: &[u8]| points(name, bytes, DVec3::ONE).unwrap_err();
        assert!(told("a.dae", b"<COLLADA/>").contains("no scene"));
        assert!(told("a.glb", b"").contains(".glb"));
        assert!(told("a.stl", &binary(b"")[..100]).contains("end is missing"));
        assert!(told("a.stl", b"no").contains("no STL"));
        assert!(told("a.obj", b"v 1 2\n").contains("line 1"));
        assert!(told("a.obj", b"# nothing\n").contains("no corners"));
        assert!(told("a.obj", b"v nan 0 0\n").contains("no numbers"));
        let large = points("a.stl", &binary(b""), DVec3::splat(1000.0)).unwrap_err();
        assert!(large.contains("500 m") && large.contains("0.001"), "{large}");
    }

    proptest! {
        #[test]
        fn no_file_is_read_past_its_end(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            for name in ["a.stl", "a.obj", "a.dae"] {
                let _ = points(name, &bytes, DVec3::ONE);
            }
        }
    }
}
