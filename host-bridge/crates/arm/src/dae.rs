//! Reads the points of meshes from COLLADA files (`.dae`, feature `urdf`).
//!
//! The reader applies the file's unit and the transforms of its nodes.
//! Like RViz and MoveIt, the reader ignores the file's up axis.
//! Authors test their robot descriptions with these programs.

use std::collections::HashMap;

use host_robot::shape::Point;
use host_robot::{DMat3, DVec3};
use roxmltree::{Document, Node};

/// Maximum nesting depth of the nodes.
const DEPTH_MAX: usize = 100;
/// Maximum number of meshes in a scene. A scene may use the same mesh more than once.
const INSTANCES_MAX: usize = 10_000;

/// An affine transform: rotation, scale and translation.
#[derive(Clone, Copy)]
struct Frame {
    turn: DMat3,
    at: DVec3,
}

impl Frame {
    fn then(&self, next: &Frame) -> Frame {
        Frame { turn: self.turn * next.turn, at: self.turn * next.at + self.at }
    }
}

/// Returns the vertices of all meshes in the file's scene, in m.
///
/// # Errors
/// Returns a message for the user that describes the problem with the file.
pub fn points(bytes: &[u8], points_max: usize) -> Result<Vec<Point>, String> {
    let text = std::str::from_utf8(bytes).map_err(|_| "it is no text in UTF-8".to_owned())?;
    let document = Document::parse(text).map_err(|error| format!("it is no XML: {error}"))?;
    let root = document.root_element();
    let ids: HashMap<&str, Node<'_, '_>> =
        root.descendants().filter_map(|node| Some((node.attribute("id")?, node))).collect();
    let find = |url: &str, what: &str| {
        let found = url.strip_prefix('#').and_then(|id| ids.get(id).copied());
        found.ok_or_else(|| format!("its {what} '{url}' is not in the file"))
    };
    let unit_m = child(root, "asset").and_then(|asset| child(asset, "unit"));
    let unit_m = match unit_m.and_then(|unit| unit.attribute("meter")) {
        None => 1.0,
        Some(text) => text
            .trim()
            .parse::<f64>()
            .ok()
            .filter(|unit_m| unit_m.is_finite() && *unit_m > 0.0)
            .ok_or_else(|| format!("its unit of '{text}' m is no length"))?,
    };
    let named = child(root, "scene").and_then(|scene| child(scene, "instance_visual_scene"));
    let scene = match named.and_then(|instance| instance.attribute("url")) {
        Some(url) => find(url, "scene")?,
        None => root.descendants().find(|node| node.has_tag_name("visual_scene")).ok_or("it has no scene")?,
    };
    let mut points = Vec::new();
    let mut instances = 0;
    let outermost = Frame { turn: DMat3::from_diagonal(DVec3::splat(unit_m)), at: DVec3::ZERO };
    let mut open: Vec<(Node<'_, '_>, Frame, usize)> = vec![(scene, outermost, 0)];
    while let Some((node, mut here, depth)) = open.pop() {
        for part in node.children().filter(Node::is_element) {
            match part.tag_name().name() {
                "matrix" | "translate" | "rotate" | "scale" => here = here.then(&frame(part)?),
                "lookat" | "skew" => {
                    return Err(format!(
                        "<{}> is not understood; export it with matrices",
                        part.tag_name().name()
                    ));
                }
                "node" if depth == DEPTH_MAX => return Err("its nodes lie too deep".to_owned()),
                "node" => open.push((part, here, depth + 1)),
                "instance_geometry" => {
                    instances += 1;
                    if instances > INSTANCES_MAX {
                        return Err(format!(
                            "its more than {INSTANCES_MAX} instances of meshes are too many"
                        ));
                    }
                    let mesh = positions(find(part.attribute("url").unwrap_or(""), "geometry")?, &find)?;
                    if points.len() + mesh.len() > points_max {
                        return Err(format!("its more than {points_max} corners are too many"));
                    }
                    points.extend(mesh.into_iter().map(|point| here.turn * point + here.at));
                }
                name @ ("instance_node" | "instance_controller") => {
                    return Err(format!("<{name}> is not understood; export it as plain meshes"));
                }
                _ => {}
            }
        }
    }
    Ok(points)
}

fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|child| child.has_tag_name(name))
}

fn numbers(node: Node<'_, '_>) -> Result<Vec<f64>, String> {
    let words = node.text().unwrap_or("").split_ascii_whitespace();
    words
        .map(|word| {
            word.parse::<f64>().map_err(|_| format!("<{}> has '{word}' for a number", node.tag_name().name()))
        })
        .collect()
}

fn frame(node: Node<'_, '_>) -> Result<Frame, String> {
    let values = numbers(node)?;
    let plain = Frame { turn: DMat3::IDENTITY, at: DVec3::ZERO };
    match (node.tag_name().name(), values.as_slice()) {
        ("translate", &[x, y, z]) => Ok(Frame { at: DVec3::new(x, y, z), ..plain }),
        ("scale", &[x, y, z]) => Ok(Frame { turn: DMat3::from_diagonal(DVec3::new(x, y, z)), ..plain }),
        ("rotate", &[x, y, z, degrees]) => {
            let axis = DVec3::new(x, y, z).try_normalize().ok_or("<rotate> has no axis")?;
            Ok(Frame { turn: DMat3::from_axis_angle(axis, degrees.to_radians()), ..plain })
        }
        // The matrix is stored row by row. The last row is always 0 0 0 1.
        ("matrix", &[a, b, c, x, d, e, f, y, g, h, i, z, ..]) if values.len() == 16 => Ok(Frame {
            turn: DMat3::from_cols(DVec3::new(a, d, g), DVec3::new(b, e, h), DVec3::new(c, f, i)),
            at: DVec3::new(x, y, z),
        }),
        (name, _) => Err(format!("<{name}> has {} numbers", values.len())),
    }
}

/// Returns the vertices of one geometry.
fn positions<'a, 'input>(
    geometry: Node<'a, 'input>,
    find: &impl Fn(&str, &str) -> Result<Node<'a, 'input>, String>,
) -> Result<Vec<Point>, String> {
    let vertices = child(geometry, "mesh").and_then(|mesh| child(mesh, "vertices"));
    let inputs = vertices.into_iter().flat_map(|vertices| vertices.children());
    let position = inputs
        .filter(|input| input.has_tag_name("input"))
        .find(|input| input.attribute("semantic") == Some("POSITION"));
    let url = position.and_then(|input| input.attribute("source")).ok_or("a geometry of it is no mesh")?;
    let source = find(url, "source")?;
    let accessor = child(source, "technique_common").and_then(|common| child(common, "accessor"));
    let accessor = accessor.ok_or("its positions have no accessor")?;
    let number = |name: &str, default: usize| match accessor.attribute(name) {
        None => Ok(default),
        Some(text) => text.trim().parse::<usize>().map_err(|_| format!("{name} '{text}' is no number")),
    };
    let (stride, offset) = (number("stride", 1)?, number("offset", 0)?);
    let count = number("count", 0)?;
    let values = numbers(find(accessor.attribute("source").unwrap_or(""), "array")?)?;
    let last = count.checked_mul(stride).and_then(|length| length.checked_add(offset));
    if stride < 3 || last.is_none_or(|last| last > values.len()) {
        return Err(format!("its {} numbers are not {count} positions", values.len()));
    }
    let corners = values[offset..].chunks(stride).take(count).filter(|chunk| chunk.len() >= 3);
    Ok(corners.map(|chunk| DVec3::new(chunk[0], chunk[1], chunk[2])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(asset: &str, nodes: &str) -> String {
        format!(
            "<?xml version=\"1.0\"?><COLLADA xmlns=\"http://www.collada.org/2005/11/COLLADASchema\" version=\"1.4.1\">\
             <asset>{asset}</asset><library_geometries><geometry id=\"g\"><mesh><source id=\"n\"><float_array id=\"na\" \
             count=\"3\">9 9 9</float_array></source><source id=\"p\"><float_array id=\"pa\" count=\"7\">7 1 0 0\n 0 2 0\
             </float_array><technique_common><accessor source=\"#pa\" count=\"2\" offset=\"1\" stride=\"3\"/>\
             </technique_common></source><vertices id=\"v\"><input semantic=\"NORMAL\" source=\"#n\"/>\
             <input semantic=\"POSITION\" source=\"#p\"/></vertices></mesh></geometry></library_geometries>\
             <library_visual_scenes><visual_scene id=\"other\"/><visual_scene id=\"s\">{nodes}</visual_scene>\
             </library_visual_scenes><scene><instance_visual_scene url=\"#s\"/></scene></COLLADA>"
        )
    }

    const HERE: &str = "<instance_geometry url=\"#g\"/>";

    fn read(asset: &str, nodes: &str) -> Result<Vec<Point>, String> {
        points(file(asset, nodes).as_bytes(), 100)
    }

    fn is(found: &[Point], wanted: &[[f64; 3]]) -> bool {
        let pairs = found.iter().zip(wanted);
        found.len() == wanted.len() && pairs.into_iter().all(|(a, b)| a.abs_diff_eq(DVec3::from(*b), 1e-12))
    }

    #[test]
    fn corners_are_where_units_and_frames_put_them_and_the_up_axis_turns_nothing() {
        let plain = read("<up_axis>Y_UP</up_axis>", &format!("<node>{HERE}</node>")).unwrap();
        assert!(is(&plain, &[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]]), "{plain:?}");
        let inches = "<unit name=\"inch\" meter=\"0.0254\"/>";
        let scaled = read(inches, &format!("<node>{HERE}</node>")).unwrap();
        assert!(is(&scaled, &[[0.0254, 0.0, 0.0], [0.0, 0.0508, 0.0]]), "{scaled:?}");
        // Transforms apply in the order of the file, and a nested node is relative to its parent.
        let within = format!(
            "<node><translate>1 0 0</translate><rotate>0 0 1 90</rotate><node><matrix>1 0 0 0 0 1 0 0 0 0 1 5 0 0 0 1</matrix>\
             <scale>2 2 2</scale>{HERE}</node></node><node>{HERE}</node>"
        );
        let mut found = read("", &within).unwrap();
        found.sort_by(|a, b| a.z.total_cmp(&b.z).then(b.x.total_cmp(&a.x)));
        let wanted = [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [1.0, 2.0, 5.0], [-3.0, 0.0, 5.0]];
        assert!(is(&found, &wanted), "{found:?}");
    }

    #[test]
    fn what_cannot_be_read_of_a_scene_is_said() {
        let told = |asset: &str, nodes: &str| read(asset, nodes).unwrap_err();
        assert!(told("<unit meter=\"-1\"/>", "").contains("no length"));
        assert!(told("", "<node><skew>1</skew></node>").contains("<skew>"));
        assert!(told("", "<node><instance_node url=\"#x\"/></node>").contains("<instance_node>"));
        assert!(told("", "<node><instance_geometry url=\"#x\"/></node>").contains("'#x' is not in the file"));
        assert!(told("", "<node><matrix>1 2</matrix></node>").contains("2 numbers"));
        assert!(told("", "<node><translate>1 x 2</translate></node>").contains("'x' for a number"));
        let deep = format!("{}{}", "<node>".repeat(150), "</node>".repeat(150));
        assert!(told("", &deep).contains("too deep"));
        assert!(told("", &format!("<node>{}</node>", HERE.repeat(60))).contains("more than 100 corners"));
        let many = format!("<node>{}</node>", HERE.repeat(INSTANCES_MAX + 1));
        let refused = points(file("", &many).as_bytes(), usize::MAX).unwrap_err();
        assert_eq!(refused, format!("its more than {INSTANCES_MAX} instances of meshes are too many"));
        let cut = file("", HERE).replace("count=\"2\"", "count=\"18446744073709551615\"");
        assert!(points(cut.as_bytes(), 100).unwrap_err().contains("are not"));
        assert!(points(b"<COLLADA>", 100).unwrap_err().contains("no XML"));
        assert!(points(&[0xff, 0xfe], 100).unwrap_err().contains("UTF-8"));
        // Entities in a document type could expand a small file without limit, so a document type is refused.
        assert!(points(b"<!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", 100).is_err());
    }
}
