//! The live view in a terminal: one screen, which is completely redrawn each time.

use std::collections::VecDeque;
use std::io::{self, Stdout, Write as _};
use std::time::Duration;

use crossterm::event::{Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers, poll, read};
use crossterm::style::{Color, Print, ResetColor, SetForegroundColor};
use crossterm::terminal::{
    Clear, ClearType, EnterAlternateScreen, LeaveAlternateScreen, disable_raw_mode, enable_raw_mode, size,
};
use crossterm::{cursor, execute, queue};
use host_core::bridge::{Nearly, Prompt};
use host_core::observe::{LinkSnapshot, Snapshot};
use host_core::safety::State;
use host_robot::Leg;

/// Size of the map of the base's path in cells.
const MAP_WIDTH: usize = 44;
const MAP_HEIGHT: usize = 9;
/// Metres per cell; cells are twice as high as wide.
const MAP_CELL_M: f64 = 0.2;

/// Minimum number of rows for a map beside the events.
const ROWS_FOR_MAP: usize = 32;

/// A key that the operator pressed.
pub enum Key {
    /// Leave.
    Quit,
    /// Stop the robot.
    Stop,
}

/// The displayed data.
pub struct Scene<'a> {
    /// The session's current state.
    pub snapshot: &'a Snapshot,
    /// Description of the keys, in one or more lines.
    pub keys: &'a str,
    /// The playback speed, if it is not 1.
    pub pace: String,
}

/// The screen. Dropping it restores the terminal, also after a panic.
pub struct View {
    out: Stdout,
    title: Vec<String>,
    events: VecDeque<String>,
    path: Vec<(f64, f64)>,
}

impl View {
    /// Takes the terminal over.
    pub fn open(title: &str) -> io::Result<Self> {
        let mut out = io::stdout();
        enable_raw_mode()?;
        let view = View {
            out: io::stdout(),
            title: title.lines().map(str::to_owned).collect(),
            events: VecDeque::new(),
            path: Vec::new(),
        };
        execute!(out, EnterAlternateScreen, cursor::Hide)?;
        Ok(view)
    }

    /// Adds a line to the list of events.
    pub fn note(&mut self, line: String) {
        if self.events.len() == 100 {
            self.events.pop_front();
        }
        self.events.push_back(line);
    }

    /// Waits for a key, for at most this long.
    pub fn key(&mut self, patience: Duration) -> io::Result<Option<Key>> {
        if !poll(patience)? {
            return Ok(None);
        }
        let Event::Key(key) = read()? else { return Ok(None) };
        if key.kind != KeyEventKind::Press {
            return Ok(None);
        }
        let control = key.modifiers.contains(KeyModifiers::CONTROL);
        Ok(match key.code {
            KeyCode::Char('c') if control => Some(Key::Quit),
            KeyCode::Char('q') | KeyCode::Esc => Some(Key::Quit),
            KeyCode::Char(' ') => Some(Key::Stop),
            _ => None,
        })
    }

    /// Returns a key event that has occurred in the meantime.
    pub fn pressed(&mut self) -> io::Result<Option<KeyEvent>> {
        while poll(Duration::ZERO)? {
            if let Event::Key(key) = read()? {
                return Ok(Some(key));
            }
        }
        Ok(None)
    }

    /// Draws the whole screen.
    pub fn draw(&mut self, scene: &Scene<'_>) -> io::Result<()> {
        let (columns, rows) = size()?;
        let here = scene.snapshot.odometry;
        if self.path.last().is_none_or(|last| (last.0 - here.x_m).hypot(last.1 - here.y_m) > 0.05) {
            self.path.push((here.x_m, here.y_m));
        }
        let mut lines = self.lines(scene, usize::from(rows) >= ROWS_FOR_MAP);
        let room = usize::from(rows).saturating_sub(lines.len() + 2);
        let skip = self.events.len().saturating_sub(room);
        lines.push((Color::DarkGrey, String::new()));
        lines.extend(self.events.iter().skip(skip).map(|line| (colour_of(line), line.clone())));
        queue!(self.out, cursor::MoveTo(0, 0))?;
        for (row, (colour, line)) in lines.iter().take(rows.into()).enumerate() {
            let cut: String = line.chars().take(columns.into()).collect();
            queue!(
                self.out,
                cursor::MoveTo(0, row as u16),
                SetForegroundColor(*colour),
                Print(cut),
                ResetColor,
                Clear(ClearType::UntilNewLine)
            )?;
        }
        queue!(self.out, Clear(ClearType::FromCursorDown))?;
        self.out.flush()
    }

    fn lines(&self, scene: &Scene<'_>, with_map: bool) -> Vec<(Color, String)> {
        let snapshot = scene.snapshot;
        let live = |link: &LinkSnapshot| match (link.connected, link.live) {
            (false, _) => "not connected",
            (true, true) => "live",
            (true, false) => "silent",
        };
        let (state, state_colour) = match snapshot.safety {
            State::Waiting => ("waiting for neutral", Color::Yellow),
            State::Armed => ("armed", Color::Green),
            State::Stale => ("a hand is silent", Color::Yellow),
            State::Refused => ("the robot refuses to move", Color::Red),
            State::Stopped => ("STOPPED", Color::Red),
        };
        let mut lines: Vec<_> = self.title.iter().map(|line| (Color::Cyan, line.clone())).collect();
        lines.extend(scene.keys.lines().map(|line| (Color::DarkGrey, line.to_owned())));
        let time_s = snapshot.time_ms as f64 / 1000.0;
        lines.push((state_colour, format!("{time_s:>7.1} s {}{state}", scene.pace)));
        let left = &snapshot.left;
        // In one-handed mode, this line shows the right hand's tilt.
        let (driving, of, link) = if snapshot.one_handed {
            ("right", "tilt", &snapshot.right.link)
        } else {
            ("left", "left", &left.link)
        };
        lines.push((
            Color::White,
            format!(
                "{of}   {:<13} pitch {:>4.0}°  roll {:>4.0}°  {:<9} cap {:.2}",
                live(link),
                left.pitch_rad.to_degrees(),
                left.roll_rad.to_degrees(),
                left.heading.name(),
                snapshot.caps.linear_m_s
            ),
        ));
        let battery = snapshot.right.link.battery_mv;
        let battery = battery.map(|mv| format!("battery {:.2} V", f64::from(mv) / 1000.0));
        let right = format!("right  {:<13} {}", live(&snapshot.right.link), battery.unwrap_or_default());
        lines.push((Color::White, right.trim_end().to_owned()));
        for (label, score) in snapshot.right.labels.iter().zip(&snapshot.right.scores) {
            let bar = "█".repeat((score * 30.0).round() as usize);
            lines.push((Color::Blue, format!("  {label:<15} {score:>4.2} {bar}")));
        }
        if let Some(Nearly { label, confidence }) = &snapshot.right.nearly {
            lines.push((Color::Yellow, format!("  almost: {label} {confidence:.1}")));
        }
        if let Some(Prompt { text, button }) = &snapshot.right.prompt {
            let key = button.map(|button| format!(" [t: {button}]")).unwrap_or_default();
            lines.push((Color::Cyan, format!("wearer{key} {text}")));
        }
        let (arm, base) = (&snapshot.arm, snapshot.odometry);
        let doing = match &arm.running {
            _ if snapshot.arm_age_ms.is_none() => "not heard of".to_owned(),
            Some((motion, Leg::Planning)) => format!("{motion}: planning"),
            Some((motion, Leg::ToHome)) => format!("{motion}: home first"),
            Some((motion, Leg::ToGoal)) => format!("{motion}: to the pose"),
            Some((_, Leg::Jogging)) => format!("moved by the {driving} hand"),
            Some((motion, Leg::Halting)) => format!("{motion}: halting"),
            None => "at rest".to_owned(),
        };
        let [x, y, z] = snapshot.flange.position_m.to_array();
        lines.push((Color::White, format!("arm    {doing:<28} flange x {x:.2} y {y:.2} z {z:.2} m")));
        lines.push((
            Color::White,
            format!(
                "base   x {:>5.2} m  y {:>5.2} m  {:>5.0}°  {:>5.2} m/s  {:>4.0}°/s",
                base.x_m,
                base.y_m,
                base.heading_rad.to_degrees(),
                base.twist.linear_m_s,
                base.twist.angular_rad_s.to_degrees()
            ),
        ));
        if snapshot.jogging {
            let held = snapshot.jog_held.as_ref().map(|why| format!("; held: {why}")).unwrap_or_default();
            lines.push((
                Color::Yellow,
                format!("JOG    the {driving} hand moves the tool, not the base{held}"),
            ));
        }
        if let Some(reason) = &snapshot.refusal {
            lines.push((Color::Red, format!("robot  {reason}")));
        }
        if let Some(text) = &snapshot.restriction {
            lines.push((Color::Yellow, format!("less   {text}")));
        }
        if let Some(reason) = &snapshot.held {
            lines.push((Color::Yellow, format!("held   {reason}")));
        }
        if with_map {
            lines.extend(self.map(base.x_m, base.y_m, base.heading_rad).map(|row| (Color::DarkGreen, row)));
        }
        lines
    }

    /// Draws the path from above: x to the right, y up, with the start in the middle.
    fn map(&self, x_m: f64, y_m: f64, heading_rad: f64) -> impl Iterator<Item = String> + use<> {
        let mut cells = vec![[' '; MAP_WIDTH]; MAP_HEIGHT];
        let mut put = |x_m: f64, y_m: f64, mark: char| {
            let column = (x_m / MAP_CELL_M).round() + (MAP_WIDTH / 2) as f64;
            let row = (MAP_HEIGHT / 2) as f64 - (y_m / (2.0 * MAP_CELL_M)).round();
            if (0.0..MAP_WIDTH as f64).contains(&column) && (0.0..MAP_HEIGHT as f64).contains(&row) {
                cells[row as usize][column as usize] = mark;
            }
        };
        for &(x_m, y_m) in &self.path {
            put(x_m, y_m, '·');
        }
        put(0.0, 0.0, '+');
        let eighth = (heading_rad / std::f64::consts::FRAC_PI_4).round().rem_euclid(8.0) as usize;
        put(x_m, y_m, ['→', '↗', '↑', '↖', '←', '↙', '↓', '↘'][eighth]);
        cells.into_iter().map(|row| format!("  {}", row.iter().collect::<String>()))
    }
}

impl Drop for View {
    fn drop(&mut self) {
        // The program ends, so an error can only be ignored.
        let _ = execute!(self.out, LeaveAlternateScreen, cursor::Show);
        let _ = disable_raw_mode();
    }
}

fn colour_of(line: &str) -> Color {
    if line.contains("HALT") {
        Color::Red
    } else if line.contains("→") {
        Color::Green
    } else {
        Color::Grey
    }
}
