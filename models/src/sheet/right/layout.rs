//! Assigns the columns of a file to the sensors and to time.

use std::collections::BTreeMap;
use std::path::Path;
use std::str::FromStr;

use super::names::{self, Kind, Named};
use crate::recording::AXIS_NAMES;
use crate::sheet::reader::Problem;
use crate::sheet::{SENSORS, Sensor};

/// Columns of one sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Source {
    /// Of x, y and z.
    pub columns: [usize; 3],
    /// Columns to add to the others: gravity, if a program stores it separately.
    pub plus: Option<[usize; 3]>,
    /// Factor to our unit, if the columns' names declare a unit.
    pub factor: Option<f64>,
    /// Factor that such names usually imply.
    pub usual: Option<f64>,
    /// Whether the names mean acceleration without gravity.
    pub linear: bool,
}

/// The used columns.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Layout {
    /// The number of the time column, and the ms per unit if its name declares the unit.
    pub time: Option<(usize, Option<f64>)>,
    /// Acceleration, turn rate, field.
    pub sensors: [Option<Source>; 3],
    /// Names of unused columns.
    pub left_out: Vec<String>,
    /// Notes for the user.
    pub notes: Vec<String>,
}

/// Names of columns that the user gives with `--columns`.
/// The names may be ours in the order of the file (`time,accX,accY,accZ,-,-`).
/// They may also be pairs of our name and the file's name, such as `accX=ax_raw,accY=ay_raw,…`.
/// A number also selects a column: `time=1` means the first column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Columns {
    /// Our name for each column of the file; `None` means unused.
    InOrder(Vec<Option<String>>),
    /// Our name for a column, and the column's name or number (from 1) in the file.
    Named(Vec<(String, String)>),
}

impl FromStr for Columns {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let ours = |name: &str| {
            let name = name.trim();
            let known =
                AXIS_NAMES.iter().copied().chain(["time"]).find(|known| known.eq_ignore_ascii_case(name));
            known.map(str::to_owned).ok_or_else(|| {
                format!(
                    "{name:?}: our columns are time, {}; - is a column that is not used",
                    AXIS_NAMES.join(", ")
                )
            })
        };
        let parts: Vec<&str> = text.split(',').map(str::trim).collect();
        let columns = if text.contains('=') {
            let pair = |part: &&str| {
                let (name, theirs) =
                    part.split_once('=').ok_or_else(|| format!("{part:?}: give OURS=THEIRS"))?;
                Ok((ours(name)?, theirs.trim().to_owned()))
            };
            Columns::Named(parts.iter().map(pair).collect::<Result<_, String>>()?)
        } else {
            let one = |part: &&str| if *part == "-" { Ok(None) } else { ours(part).map(Some) };
            Columns::InOrder(parts.iter().map(one).collect::<Result<_, String>>()?)
        };
        let names: Vec<&String> = match &columns {
            Columns::InOrder(list) => list.iter().flatten().collect(),
            Columns::Named(list) => list.iter().map(|(ours, _)| ours).collect(),
        };
        let missing: Vec<&str> =
            AXIS_NAMES[..3].iter().copied().filter(|axis| !names.iter().any(|n| n == axis)).collect();
        if !missing.is_empty() {
            return Err(format!(
                "{} is not named; a recording needs accX, accY and accZ",
                missing.join(", ")
            ));
        }
        if (1..names.len()).any(|at| names[..at].contains(&names[at])) {
            return Err("a column is named twice".to_owned());
        }
        Ok(columns)
    }
}

impl Layout {
    /// Assigns columns by names from the user.
    pub(super) fn given(columns: &Columns, header: &[String]) -> Result<Self, Problem> {
        let mut found: BTreeMap<&str, usize> = BTreeMap::new();
        match columns {
            Columns::InOrder(list) => {
                if list.len() > header.len() {
                    let text =
                        format!("--columns names {} columns, the file has {}", list.len(), header.len());
                    return Err((0, String::new(), text));
                }
                found.extend(list.iter().enumerate().filter_map(|(at, name)| Some((name.as_deref()?, at))));
            }
            Columns::Named(list) => {
                for (ours, theirs) in list {
                    let by_number =
                        theirs.parse().ok().filter(|n| (1..=header.len()).contains(n)).map(|n| n - 1);
                    let by_name = || header.iter().position(|name| name == theirs);
                    let Some(at) = by_number.or_else(by_name) else {
                        let text =
                            format!("--columns: no column is called that; there are {}", header.join(", "));
                        return Err((0, theirs.clone(), text));
                    };
                    found.insert(ours, at);
                }
            }
        }
        let mut layout = Layout::default();
        if let Some(&at) = found.get("time") {
            layout.time = Some((at, header.get(at).and_then(|name| names::time(name)?.1)));
        }
        for (kind, sensor) in layout.sensors.iter_mut().enumerate() {
            let columns: Vec<usize> =
                (3 * kind..3 * kind + 3).filter_map(|n| found.get(AXIS_NAMES[n]).copied()).collect();
            match columns.as_slice() {
                [] => {}
                &[x, y, z] => {
                    let declared = names::sample(&header[x]).and_then(|named| named.factor);
                    *sensor = Some(Source { columns: [x, y, z], factor: declared, ..Source::default() });
                }
                _ => {
                    let text = format!("--columns names {} of {}'s three axes", columns.len(), SENSORS[kind]);
                    return Err((0, String::new(), text));
                }
            }
        }
        let used = |at: &usize| found.values().any(|column| column == at);
        layout.left_out = (0..header.len()).filter(|at| !used(at)).map(|at| header[at].clone()).collect();
        Ok(layout)
    }

    /// Assigns columns by the names in a header. `file` identifies the sensor if the names are only x, y, z.
    pub(super) fn of(header: &[String], file: &Path) -> Result<Self, Problem> {
        let mut layout = Layout::default();
        let times = header.iter().enumerate().filter_map(|(at, name)| Some((names::time(name)?, at)));
        if let Some(((_, unit), at)) = times.min_by_key(|((rank, _), at)| (*rank, *at)) {
            layout.time = Some((at, unit));
        }
        // Columns of one sensor have the same kind and stem. Groups are sorted by their first column.
        let mut groups: Vec<Group> = Vec::new();
        for (at, name) in header.iter().enumerate() {
            let Some(named) = names::sample(name) else { continue };
            let place = groups.iter().position(|g| g.kind == named.kind && g.stem == named.stem);
            let group = match place {
                Some(place) => &mut groups[place],
                None => {
                    groups.push(Group {
                        kind: named.kind,
                        stem: named.stem.clone(),
                        axes: [None, None, None],
                    });
                    groups.last_mut().ok_or((0, String::new(), String::new()))?
                }
            };
            if group.axes[named.axis].is_some() {
                return Err((
                    at + 1,
                    name.clone(),
                    "this column is there twice; delete one, or name columns with --columns".to_owned(),
                ));
            }
            let axis = named.axis;
            group.axes[axis] = Some((at, named));
        }
        let bare = bare(file);
        for group in groups.iter_mut().filter(|group| group.kind == Kind::Bare) {
            group.kind = bare;
        }
        for kinds in
            [&[Kind::GForce, Kind::Acceleration, Kind::Linear][..], &[Kind::TurnRate][..], &[Kind::Field][..]]
        {
            layout.choose(kinds, &groups, header)?;
        }
        // The file contains only gravity.
        if layout.sensors.iter().all(Option::is_none) && bare == Kind::Gravity {
            layout.sensors[0] = groups.iter().find_map(Group::source);
        }
        layout.gyroscope_without_a_name(header);
        let mut used: Vec<usize> = layout.time.iter().map(|(at, _)| *at).collect();
        for source in layout.sensors.iter().flatten() {
            used.extend(source.columns.iter().chain(source.plus.iter().flatten()));
        }
        let rest = header.iter().enumerate().filter(|(at, name)| !used.contains(at) && !name.is_empty());
        layout.left_out = rest.map(|(_, name)| name.clone()).collect();
        Ok(layout)
    }

    /// Selects the first of these kinds that has a complete group, and uses its first complete group.
    fn choose(&mut self, kinds: &[Kind], groups: &[Group], header: &[String]) -> Result<(), Problem> {
        let of = |kind: Kind| groups.iter().filter(move |group| group.kind == kind);
        let slot = match kinds[0].sensor() {
            Some(sensor) => &mut self.sensors[sensor as usize],
            None => return Ok(()),
        };
        for &kind in kinds {
            let mut whole = of(kind).filter(|group| group.is_whole());
            let Some(group) = whole.next() else { continue };
            *slot = group.source();
            let others: Vec<&str> = whole.map(|group| group.first_name(header)).collect();
            if !others.is_empty() {
                self.notes.push(format!(
                    "{} is used, {} and its like are not",
                    group.first_name(header),
                    others.join(", ")
                ));
            }
            let gravity = of(Kind::Gravity).find(|group| group.is_whole());
            if let (Kind::Linear, Some(gravity), Some(source)) = (kind, gravity, slot) {
                source.plus = gravity.columns();
                source.linear = false;
                let (a, b) = (group.first_name(header), gravity.first_name(header));
                self.notes.push(format!("acceleration is {a} and {b} together"));
            }
            return Ok(());
        }
        // No group has all axes. A sensor with a missing axis must not be ignored silently.
        let broken = kinds.iter().flat_map(|kind| of(*kind)).find(|group| group.is_meant(header));
        match broken {
            None => Ok(()),
            Some(group) => {
                let missing: Vec<&str> = (0..3)
                    .filter(|axis| group.axes[*axis].is_none())
                    .map(|axis| ["x", "y", "z"][axis])
                    .collect();
                let name = group.first_name(header);
                let text = format!(
                    "this sensor has no {}; delete what is not whole, name columns with --columns, or record it again",
                    missing.join(" and no ")
                );
                Err((header.iter().position(|n| n == name).map_or(0, |at| at + 1), name.to_owned(), text))
            }
        }
    }

    /// Sensor Logger writes `seconds_elapsed,z,y,x` with rad/s, without declaring the unit.
    fn gyroscope_without_a_name(&mut self, header: &[String]) {
        if header.iter().any(|name| name == "seconds_elapsed")
            && let Some(source) = &mut self.sensors[Sensor::TurnRate as usize]
            && source.factor.is_none()
        {
            source.usual = names::factor(Sensor::TurnRate, "rad/s");
        }
    }
}

/// Returns the content of columns x, y, z, which the file's name reveals.
fn bare(file: &Path) -> Kind {
    let name = file.file_stem().unwrap_or_default().to_string_lossy().to_lowercase();
    match () {
        () if name.contains("gyr") => Kind::TurnRate,
        () if name.contains("magn") => Kind::Field,
        () if name.contains("gravity") => Kind::Gravity,
        () if name.contains("linear") => Kind::Linear,
        () => Kind::Acceleration,
    }
}

struct Group {
    kind: Kind,
    stem: String,
    axes: [Option<(usize, Named)>; 3],
}

impl Group {
    fn is_whole(&self) -> bool {
        self.axes.iter().all(Option::is_some)
    }

    /// Returns whether more than one name was recognised, because a single name may be accidental.
    fn is_meant(&self, header: &[String]) -> bool {
        let known = |at: usize| AXIS_NAMES.contains(&header[at].as_str());
        !self.is_whole()
            && (self.axes.iter().flatten().count() > 1
                || self.axes.iter().flatten().any(|(at, _)| known(*at)))
    }

    fn columns(&self) -> Option<[usize; 3]> {
        match &self.axes {
            [Some((x, _)), Some((y, _)), Some((z, _))] => Some([*x, *y, *z]),
            _ => None,
        }
    }

    fn source(&self) -> Option<Source> {
        let columns = self.columns()?;
        let mut named = self.axes.iter().flatten().map(|(_, named)| named);
        let first = named.next()?;
        Some(Source {
            columns,
            plus: None,
            factor: first.factor.filter(|factor| named.all(|other| other.factor == Some(*factor))),
            usual: first.usual,
            linear: self.kind == Kind::Linear,
        })
    }

    fn first_name<'h>(&self, header: &'h [String]) -> &'h str {
        let at = self.axes.iter().flatten().map(|(at, _)| *at).min();
        at.and_then(|at| header.get(at)).map_or("", String::as_str)
    }
}
