//! The configuration file (TOML), with all ports, thresholds, limits and mappings.
//!
//! `host-bridge run --print-config` writes a configuration with all keys.
//! An unknown key is an error. The message contains its line and the most similar known key.
//! Unsafe values are errors too.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shared_proto::message::TiltThresholds;
use toml::de::{DeTable, DeValue};

use crate::arm::model::SerialArm;
use crate::arm::motions::{MotionTable, PoseTable};
use crate::arm::scene::{JERK_MIN_RAD_S3, Route};
use crate::base::BaseConfig;
use crate::bridge::{Bridge, Restriction};
use crate::episodes::Mark;
use crate::intent::{MotionMap, SpeedRules, is_rest, same_label};
use crate::jog::JogRules;
use crate::keyboard::KeyTimes;
use crate::one_handed::OneHanded;
use crate::robot::{JointLimits, MotionName};
use crate::ros2::Ros2Config;
use crate::safety::PerHand;
use crate::safety::SafetyTimes;
use crate::tilt::TiltDrive;

/// This value in place of a port means that the user controls the hand with keys.
pub const KEYBOARD: &str = "keyboard";

/// Maximum speed of the base in m/s and rad/s if boards are accepted without a bond.
const UNBONDED_MOST: f64 = 0.2;

/// The source of a hand's data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HandInput {
    /// This hand is not used.
    Nobody,
    /// A board on a link.
    Board,
    /// The keyboard replaces the board.
    Keyboard,
}

/// All settings. The defaults are the paper's values, or the safest ones.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Exchanges the hands.
    /// Then `left` is the port of the gesture board, and `right` is the port of the tilt board.
    pub left_handed: bool,
    /// The ports of the boards.
    pub ports: Ports,
    /// Tilt thresholds, sent to the left hand's board at its start.
    pub tilt: TiltThresholds,
    /// Caps on the base's speed.
    pub speed: SpeedRules,
    /// The conversion of a tilt to a speed within these caps.
    /// The speed is one of the paper's four headings, or proportional to the tilt.
    pub drive: TiltDrive,
    /// The rules by which the left hand controls the arm, and the tool's speed in that case. Off by default.
    pub jog: JogRules,
    /// The right hand alone: its own tilt drives the base. Off by default.
    pub one_handed: OneHanded,
    /// The vibration signals for the wearer of the right hand.
    pub vibration: Vibration,
    /// The times after which silent hands stop the robot.
    pub safety: SafetyTimes,
    /// Duration for which a key press remains in effect.
    pub keyboard: KeyTimes,
    /// The simulated base.
    pub base: BaseConfig,
    /// The simulated arm.
    pub arm: Arm,
    /// The robot on a ROS 2 graph, for `--ros2`.
    pub ros2: Ros2Config,
    /// Maps labels to motions or poses. Labels without an entry keep the paper's motion.
    pub motions: BTreeMap<String, String>,
    /// Maps labels to `begin`, `end`, `again`, `good` or `bad`.
    /// These gestures mark episodes of a recorded session and do not move anything.
    pub marks: BTreeMap<String, Mark>,
    /// Your own motions, which replace bundled ones with the same name.
    pub motion: Vec<MotionTable>,
    /// Your own poses, as joint angles.
    pub pose: Vec<PoseTable>,
}

/// The ports of the boards.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Ports {
    /// The value is a port, `keyboard`, or empty for no hand.
    pub left: String,
    /// The value is a port, `keyboard`, or empty for no hand.
    pub right: String,
    /// Baud rate of the serial lines.
    pub baud: u32,
    /// Nothing is sent for this long after a port was opened, unless the board sends first.
    pub settle_ms: u64,
    /// Whether unbonded boards over Bluetooth may move the base (at most 0.2 m/s), but never the arm.
    /// This setting is for serial modules that cannot bond.
    /// Any device in range can impersonate such a module.
    pub allow_unbonded: bool,
}

impl Default for Ports {
    fn default() -> Self {
        let serial = crate::links::SerialSettings::default();
        Ports {
            left: String::new(),
            right: String::new(),
            baud: serial.baud,
            settle_ms: serial.settle_ms,
            allow_unbonded: false,
        }
    }
}

/// Settings of the vibration motor at the right hand's board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Vibration {
    /// Whether a motor is connected, which signals accepted and refused gestures, stops and lost links.
    pub wired: bool,
}

/// The route of the arm, the fraction of its own limits that may be used (0 to 1), and the choice of a jerk limit.
/// In a scene, the scene's own table `[arm]` applies instead.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Arm {
    /// `via-home` as in the paper, or `direct`: straight to the pose if the arm then stays clear of the robot and the floor.
    pub route: Route,
    /// Fraction of the maximum joint speeds.
    pub velocity_scaling: f64,
    /// Fraction of the maximum joint accelerations.
    pub acceleration_scaling: f64,
    /// Whether jerk is limited to `jerk_rad_s3`, also while stopping.
    pub jerk_limited: bool,
    /// The jerk limit of every joint. The fractions above do not scale it.
    pub jerk_rad_s3: f64,
}

impl Default for Arm {
    fn default() -> Self {
        use crate::arm::gen3::{ACCELERATION_SCALING, MAX_JERK_RAD_S3, VELOCITY_SCALING};
        Arm {
            route: Route::ViaHome,
            velocity_scaling: VELOCITY_SCALING,
            acceleration_scaling: ACCELERATION_SCALING,
            jerk_limited: false,
            jerk_rad_s3: MAX_JERK_RAD_S3,
        }
    }
}

/// The reason why a configuration cannot be used, with the line and a remedy.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// A key that does not exist.
    #[error("line {line}: there is no key '{key}'{}; `host-bridge run --print-config` shows all keys",
        nearest.as_ref().map(|n| format!(", did you mean '{n}'?")).unwrap_or_default())]
    UnknownKey {
        /// Line, from 1.
        line: usize,
        /// Full name of the key, including its tables.
        key: String,
        /// The most similar known key.
        nearest: Option<String>,
    },
    /// The text is not valid TOML, or a value has the wrong type.
    #[error("line {line}: {what}")]
    Text {
        /// Line, from 1.
        line: usize,
        /// The parser's error message.
        what: String,
    },
    /// A value is invalid or unsafe.
    #[error("{0}")]
    Value(String),
}

impl Config {
    /// Reads a file's text.
    ///
    /// # Errors
    /// Returns a [`ConfigError`], with the line if it is known.
    pub fn parse(text: &str) -> Result<Self, ConfigError> {
        let line = |at: usize| text.get(..at).map_or(1, |before| before.matches('\n').count() + 1);
        let refused = |error: toml::de::Error| ConfigError::Text {
            line: line(error.span().map_or(0, |span| span.start)),
            what: error.message().trim().replace('\n', "; "),
        };
        let table = DeTable::parse(text).map_err(refused)?;
        let known = toml::Value::try_from(Config::default()).ok();
        if let Some(toml::Value::Table(known)) = known {
            check_keys(table.get_ref(), &known, "", &line)?;
        }
        let config: Config = toml::from_str(text).map_err(refused)?;
        config.check()?;
        Ok(config)
    }

    /// Returns all keys with their values as the text of a file.
    pub fn to_toml(&self) -> String {
        // The data consists only of strings, numbers and tables, so this cannot fail.
        toml::to_string(self).unwrap_or_default()
    }

    /// Returns the ports of the left and right hand, exchanged for left-handed users.
    /// An empty text means no port.
    pub fn hand_ports(&self) -> [&str; 2] {
        let Ports { left, right, .. } = &self.ports;
        if self.left_handed { [right, left] } else { [left, right] }
    }

    /// Returns the source of each hand's data.
    pub fn inputs(&self) -> PerHand<HandInput> {
        PerHand::from(self.hand_ports()).map(|port| match port {
            "" => HandInput::Nobody,
            KEYBOARD => HandInput::Keyboard,
            _ => HandInput::Board,
        })
    }

    /// Returns the paper's map with this file's changes.
    pub fn motion_map(&self) -> MotionMap {
        let mut map = MotionMap::default();
        for (label, motion) in &self.motions {
            // `check` has verified that everything can be assigned.
            let _ = map.assign(&format!("{label}={motion}"));
        }
        for label in self.marks.keys().chain([&self.jog.label].into_iter().filter(|label| !label.is_empty()))
        {
            map.release(label);
        }
        map
    }

    /// Returns the changes to the paper's map as `LABEL=MOTION`.
    pub fn mappings(&self) -> Vec<String> {
        self.motions.iter().map(|(label, motion)| format!("{label}={motion}")).collect()
    }

    /// Returns the restriction of a session in which boards need no bond.
    pub fn restriction(&self) -> Option<Restriction> {
        let text = format!(
            "unbonded boards are allowed: the base alone, at most {UNBONDED_MOST} m/s (allow_unbonded in [ports])"
        );
        self.ports.allow_unbonded.then_some(Restriction { most: UNBONDED_MOST, text })
    }

    /// Creates a bridge as configured here.
    pub fn bridge(&self, map: MotionMap) -> Bridge {
        let bridge = Bridge::with(map, self.speed, self.safety)
            .driving(self.drive)
            .jogging_by(self.jog.clone())
            .one_handed(self.one_handed, self.tilt);
        match self.restriction() {
            Some(restriction) => bridge.restricted(restriction),
            None => bridge,
        }
    }

    /// Returns the limits of the arm.
    pub fn arm_limits(&self) -> JointLimits {
        let Arm { velocity_scaling, acceleration_scaling, jerk_limited, jerk_rad_s3, .. } = self.arm;
        let limits = SerialArm::gen3().limits(velocity_scaling, acceleration_scaling);
        if jerk_limited { limits.with_jerk(jerk_rad_s3) } else { limits }
    }

    /// Checks that all values are valid. [`Config::parse`] calls it; call it again after a manual change.
    ///
    /// # Errors
    /// Returns [`ConfigError::Value`] for the first invalid value.
    pub fn check(&self) -> Result<(), ConfigError> {
        let ensure = |sound: bool, what: &str| {
            if sound { Ok(()) } else { Err(ConfigError::Value(what.to_owned())) }
        };
        // This check comes first, because the checks below compare each entry with all others.
        ensure(self.motions.len() <= 200, "motions: at most 200 labels; a model names no more than 16")?;
        ensure(
            self.tilt.are_sound(),
            "tilt: 17 <= neutral_mrad < end_mrad < start_mrad <= 1047 (60°) must hold",
        )?;
        let speed = self.speed;
        let within = |value: f64, least: f64, most: f64| value >= least && value <= most;
        ensure(
            within(speed.most, 0.01, 2.0)
                && within(speed.least, 0.01, speed.most)
                && within(speed.start, speed.least, speed.most),
            "speed: 0.01 <= least <= start <= most <= 2.0 must hold",
        )?;
        ensure(
            within(speed.faster, 1.0, 2.0) && within(speed.slower, 0.1, 1.0),
            "speed: faster lies between 1 and 2, slower between 0.1 and 1",
        )?;
        ensure(
            self.drive.is_sound(),
            "drive: dead_mrad lies between 35 (2°) and 349 (20°), full_mrad 87 or more beyond it and at most 1309 (75°), gain \
             between 0.1 and 5, linear_most and angular_most between 0.05 and 1",
        )?;
        ensure(
            (20..=250).contains(&self.safety.stale_ms),
            "safety: stale_ms lies between 20 and 250: a silent hand must stop the robot within a quarter second",
        )?;
        ensure(
            (100..=10_000).contains(&self.safety.arm_neutral_ms)
                && (1000..=60_000).contains(&self.safety.release_neutral_ms),
            "safety: arm_neutral_ms lies between 100 and 10000, release_neutral_ms between 1000 and 60000",
        )?;
        ensure(
            (50..=1000).contains(&self.keyboard.first_press_ms)
                && (50..=1000).contains(&self.keyboard.repeat_ms),
            "keyboard: first_press_ms and repeat_ms lie between 50 and 1000",
        )?;
        let end_arm = self.keyboard.end_arm;
        ensure(
            end_arm.is_ascii_lowercase() && !"qrzbeagn".contains(end_arm),
            "keyboard: end_arm is one small letter, other than q, r, z and those that mark episodes (b, e, a, g, n)",
        )?;
        self.check_jog()?;
        self.check_one_handed()?;
        ensure(
            self.motion.iter().all(|motion| motion.name != MotionName::END_ARM),
            "motion: the name end-arm is taken: as a label's motion it ends the one under way",
        )?;
        let base = self.base;
        ensure(
            within(base.wheel_radius_m, 0.01, 1.0)
                && within(base.track_m, 0.05, 3.0)
                && within(base.wheel_speed_max_rad_s, 0.1, 100.0)
                && within(base.wheel_acceleration_max_rad_s2, 0.1, 1000.0),
            "base: a size or limit is out of range; --print-config shows usual ones",
        )?;
        ensure(
            within(self.arm.velocity_scaling, 0.01, 1.0) && within(self.arm.acceleration_scaling, 0.01, 1.0),
            "arm: scalings lie between 0.01 and 1",
        )?;
        ensure(
            within(self.arm.jerk_rad_s3, JERK_MIN_RAD_S3, f64::MAX),
            "arm: jerk_rad_s3 is 0.5 or more: with less, a stop would take seconds",
        )?;
        ensure(
            (9600..=2_000_000).contains(&self.ports.baud) && self.ports.settle_ms <= 60_000,
            "ports: baud lies between 9600 and 2000000 (1200 resets boards into their bootloader), settle_ms is at most 60000",
        )?;
        self.ros2.check().map_err(ConfigError::Value)?;
        let mut map = MotionMap::default();
        for (label, motion) in &self.motions {
            map.assign(&format!("{label}={motion}"))
                .map_err(|error| ConfigError::Value(format!("motions: {error}")))?;
        }
        ensure(self.marks.len() <= 200, "marks: at most 200 labels")?;
        for label in self.marks.keys() {
            ensure(
                !is_rest(label),
                &format!("marks: '{label}' is the class of a resting hand; mark with a gesture"),
            )?;
            ensure(
                !self.motions.keys().any(|moving| same_label(moving, label)),
                &format!("marks: '{label}' has a motion under motions; a gesture does one or the other"),
            )?;
            ensure(
                !map.motion(label).is_some_and(|motion| *motion == *MotionName::HOME),
                &format!(
                    "marks: '{label}' releases a stop; mark with another gesture, or give home another one"
                ),
            )?;
        }
        Ok(())
    }

    fn check_one_handed(&self) -> Result<(), ConfigError> {
        let ensure = |sound: bool, what: &str| {
            if sound { Ok(()) } else { Err(ConfigError::Value(what.to_owned())) }
        };
        ensure(
            self.one_handed.is_sound(),
            "one_handed: forward, left and up name three different axes (such as '+x', '+y' and '+z'), and neutral_pitch_mrad \
             and neutral_roll_mrad are at most 524 (30°) off level",
        )?;
        let inputs = self.inputs();
        ensure(
            !self.one_handed.on || inputs.left == HandInput::Nobody,
            "one-handed: the right hand drives the base, so there is no left hand: leave out --left and the left hand's port, \
             or leave out --one-handed (on = false under [one_handed])",
        )?;
        ensure(
            !self.one_handed.on || inputs.right != HandInput::Keyboard,
            "one-handed: keys have no tilt: give the port of the right hand's board with --right",
        )
    }

    fn check_jog(&self) -> Result<(), ConfigError> {
        let JogRules { label, key, .. } = &self.jog;
        let ensure = |sound: bool, what: String| if sound { Ok(()) } else { Err(ConfigError::Value(what)) };
        ensure(
            self.jog.is_sound(),
            "jog: speed_m_s and lift_m_s lie between 0.005 and 0.5, bend_ms between 100 and 2000".to_owned(),
        )?;
        let is_free = |letter: char| letter.is_ascii_lowercase() && !"qrzbeagn".contains(letter);
        let mut letters = key.chars();
        ensure(
            key.is_empty()
                || letters.next().is_some_and(|letter| is_free(letter) && letter != self.keyboard.end_arm)
                    && letters.next().is_none(),
            format!(
                "jog: key is one small letter, other than q, r, z, {} (end_arm) and those that mark episodes (b, e, a, g, n)",
                self.keyboard.end_arm
            ),
        )?;
        if label.is_empty() {
            return Ok(());
        }
        ensure(
            !is_rest(label),
            format!("jog: '{label}' is the class of a resting hand; move the clutch with a gesture"),
        )?;
        ensure(
            !self.motions.keys().chain(self.marks.keys()).any(|taken| same_label(taken, label)),
            format!("jog: '{label}' has a motion or a mark; a gesture does one or the other"),
        )?;
        let mut map = MotionMap::default();
        for (known, motion) in &self.motions {
            let _ = map.assign(&format!("{known}={motion}"));
        }
        ensure(
            !map.motion(label).is_some_and(|motion| *motion == *MotionName::HOME),
            format!("jog: '{label}' releases a stop; take another gesture, or give home another one"),
        )
    }
}

/// Checks that every key is known. Keys of `motions` and `marks` are labels, so they may be arbitrary.
fn check_keys(
    table: &DeTable<'_>,
    known: &toml::Table,
    path: &str,
    line: &impl Fn(usize) -> usize,
) -> Result<(), ConfigError> {
    for (key, value) in table {
        let name: &str = key.get_ref().as_ref();
        let Some(there) = known.get(name) else {
            let near = |candidate: &&String| strsim::normalized_damerau_levenshtein(candidate, name);
            let nearest = known.keys().max_by(|a, b| near(a).total_cmp(&near(b)));
            return Err(ConfigError::UnknownKey {
                line: line(key.span().start),
                key: format!("{path}{name}"),
                nearest: nearest.filter(|candidate| near(candidate) > 0.4).map(|n| format!("{path}{n}")),
            });
        };
        if !["motions", "marks"].contains(&name)
            && let (DeValue::Table(inner), toml::Value::Table(there)) = (value.get_ref(), there)
        {
            check_keys(inner, there, &format!("{path}{name}."), line)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_printed_reads_back_as_the_same_and_names_every_key() {
        let text = Config::default().to_toml();
        assert_eq!(Config::parse(&text).unwrap(), Config::default());
        for key in ["left_handed", "settle_ms", "start_mrad", "stale_ms", "faster", "track_m", "repeat_ms"] {
            assert!(text.contains(key), "{key} in\n{text}");
        }
        assert_eq!(Config::parse("").unwrap(), Config::default());
    }

    #[test]
    fn an_unknown_key_is_named_with_its_line_and_the_nearest_one() {
        let error = Config::parse("left_handed = true\n\n[safety]\nstale = 100\n").unwrap_err();
        let (key, nearest) = ("safety.stale".to_owned(), Some("safety.stale_ms".to_owned()));
        assert_eq!(error, ConfigError::UnknownKey { line: 4, key, nearest });
        let text = error.to_string();
        assert!(text.contains("line 4") && text.contains("did you mean 'safety.stale_ms'?"), "{text}");
        let error = Config::parse("[port]\nleft = 'x'\n").unwrap_err();
        assert!(error.to_string().contains("did you mean 'ports'?"), "{error}");
        let error = Config::parse("zzzzzz = 1").unwrap_err();
        assert!(error.to_string().contains("--print-config"), "{error}");
    }

    #[test]
    fn values_of_another_kind_and_broken_text_are_named_with_their_line() {
        for (text, line) in [("\n[tilt]\nend_mrad = 'x'\n", 3), ("\n[tilt\n", 2), ("[ports]\nbaud = -1\n", 2)]
        {
            match Config::parse(text) {
                Err(ConfigError::Text { line: found, .. }) => assert_eq!(found, line, "{text}"),
                other => panic!("{text}: {other:?}"),
            }
        }
    }

    #[test]
    fn unsafe_values_are_refused() {
        for text in [
            "[safety]\nstale_ms = 5000",
            "[safety]\narm_neutral_ms = 0",
            "[speed]\nmost = 9.0",
            "[speed]\nstart = nan",
            "[speed]\nleast = 0.9\nmost = 0.5",
            "[tilt]\nneutral_mrad = 300",
            "[drive]\nproportional = true\ngain = 100.0",
            "[drive]\ndead_mrad = 0",
            "[drive]\nlinear_most = nan",
            "[jog]\nspeed_m_s = nan",
            "[jog]\nbend_ms = 0",
            "[jog]\nkey = 'q'",
            "[jog]\nkey = 'x'",
            "[jog]\nkey = 'jj'",
            "[jog]\nlabel = 'idle'",
            "[jog]\nlabel = 'up-down'",
            "[jog]\nlabel = 'wave'\n[motions]\nWave = 'pick-up'",
            "[one_handed]\nleft = '+x'",
            "[one_handed]\nneutral_pitch_mrad = 600",
            "[one_handed]\non = true\n[ports]\nleft = '/dev/ttyUSB0'\nright = '/dev/ttyACM0'",
            "[one_handed]\non = true\n[ports]\nright = 'keyboard'",
            "[jog]\nlabel = 'wave'\n[marks]\nwave = 'begin'",
            "[keyboard]\nfirst_press_ms = 10000",
            "[arm]\nvelocity_scaling = 3.0",
            "[arm]\njerk_limited = true\njerk_rad_s3 = 0.0",
            "[base]\ntrack_m = 0.0",
            "[ros2]\nrate_hz = 1",
            "[motions]\nidle = 'home'",
            "[marks]\nup-down = 'begin'",
            "[marks]\nother = 'begin'",
            "[marks]\nwave = 'begin'\n[motions]\nWave = 'pick-up'",
        ] {
            let error = Config::parse(text).unwrap_err();
            assert!(matches!(error, ConfigError::Value(_)), "{text}: {error}");
        }
    }

    #[test]
    fn a_label_of_your_own_gets_a_motion_and_the_others_keep_theirs() {
        let map = Config::parse("[motions]\nwave = 'pick-up'\n").unwrap().motion_map();
        assert_eq!(map.motion("wave"), Some(&MotionName::from("pick-up")));
        assert_eq!(map.motion("circle"), Some(&MotionName::from("random-top")));
    }

    #[test]
    fn a_label_that_moves_the_clutch_starts_no_motion_and_without_one_there_is_no_clutch() {
        let config = Config::parse("[jog]\nlabel = 'circle'\nkey = 'j'\n").unwrap();
        assert!(config.jog.is_on() && !Config::default().jog.is_on());
        assert_eq!(config.motion_map().motion("circle"), None);
        assert_eq!(Config::parse(&config.to_toml()).unwrap(), config);
    }

    #[test]
    fn one_handed_mode_is_off_by_default_and_its_file_reads_back() {
        assert!(!Config::default().one_handed.on);
        let text = "[one_handed]\non = true\nforward = '-y'\nleft = '+x'\n[ports]\nright = 'ble'\n";
        let config = Config::parse(text).unwrap();
        assert_eq!(Config::parse(&config.to_toml()).unwrap(), config);
        let exchanged = format!("left_handed = true\n{}", text.replace("right = 'ble'", "left = 'ble'"));
        assert!(Config::parse(&exchanged).is_ok(), "the left port is then that of the gesture board");
    }

    #[test]
    fn a_label_that_marks_episodes_starts_no_motion() {
        let config = Config::parse("[marks]\ncircle = 'begin'\nto-fro = 'again'\n").unwrap();
        assert_eq!(config.marks["circle"], Mark::Begin);
        assert_eq!(config.motion_map().motion("circle"), None);
        assert_eq!(config.motion_map().motion("left-right"), Some(&MotionName::from("place")));
        assert_eq!(Config::parse(&config.to_toml()).unwrap(), config);
        let error = Config::parse("[marks]\ncircle = 'start'\n").unwrap_err().to_string();
        assert!(error.contains("line 2") && error.contains("again"), "{error}");
    }
}
