//! The bridge's part of jogging.
//! This part determines which part of the robot the left hand moves,
//! which motion is requested of the tool, and the effect of bends.

use host_robot::{Busy, DVec3, Door, MotionName, NotStarted};

use super::{Bridge, EventKind, GestureOutcome};
use crate::intent::{is_rest, same_label};
use crate::jog::{self, JogRules};
use crate::safety::{self, Hand, State};

impl Bridge {
    /// Sets the rules for jogging, such as the gesture that switches the left hand to the arm.
    #[must_use]
    pub fn jogging_by(self, jog: JogRules) -> Self {
        Bridge { jog, ..self }
    }

    /// The left hand is lent to the arm.
    pub fn is_jogging(&self) -> bool {
        self.safety.is_lent()
    }

    /// Processes the clutch's key, which switches the left hand from the base to the arm, or back.
    pub fn clutch_key(&mut self, now_ms: u64, robot: &mut dyn Door) {
        if self.jog.is_on() {
            let _ = self.clutch(0, now_ms, robot);
        }
    }

    pub(super) fn is_clutch(&self, label: &str) -> bool {
        !self.jog.label.is_empty() && same_label(&self.jog.label, label)
    }

    pub(super) fn clutch(&mut self, age_ms: u64, now_ms: u64, robot: &mut dyn Door) -> GestureOutcome {
        if age_ms > self.safety.times().stale_ms {
            return GestureOutcome::Late;
        }
        if self.safety.is_lent() {
            self.take_back(now_ms, robot);
            return GestureOutcome::TakenBack;
        }
        if self.safety.state() != State::Armed {
            return GestureOutcome::NotArmed;
        }
        if let Err(reason) = self.can_lend(robot) {
            return self.refuse(MotionName::from(MotionName::JOG), reason, now_ms);
        }
        self.apply(safety::Event::Clutch { lends: true }, now_ms, robot);
        GestureOutcome::Lent
    }

    /// Returns the left hand to the base, in any state.
    pub(super) fn take_back(&mut self, now_ms: u64, robot: &mut dyn Door) {
        self.apply(safety::Event::Clutch { lends: false }, now_ms, robot);
    }

    fn can_lend(&self, robot: &dyn Door) -> Result<(), String> {
        if let Some(restriction) = &self.restriction {
            return Err(restriction.text.clone());
        }
        if !self.safety.connected(Hand::Left) {
            return Err("there is no left hand that could move the tool".to_owned());
        }
        let labels = self.links.right.model().map_or(&[][..], |model| &model.labels);
        if !self.safety.connected(Hand::Right) || !labels.iter().any(|label| is_rest(label)) {
            return Err(
                "the right hand's rest is the dead-man of jogging: it needs a right hand whose model names a resting \
                 class (idle)"
                    .to_owned(),
            );
        }
        robot.can_jog().map_err(|error| match error {
            NotStarted::Busy(Busy(motion)) => format!("the arm is busy with {motion}; let it end first"),
            NotStarted::Refused(why) => why,
        })
    }

    /// Applies bends: a lent hand lifts the tool, and any other hand changes the speed.
    pub(super) fn bends(&mut self, index: u8, middle: u8, now_ms: u64, robot: &mut dyn Door) {
        if self.safety.is_lent() {
            self.lift.bend(index, middle, self.jog.bend_ms, now_ms);
            return;
        }
        self.caps.bend(index, middle);
        if self.caps.rules.arm && robot.picture().arm.is_on_its_way() {
            self.caps.bend_pace(index, middle);
            robot.pace(self.caps.pace);
        }
        let cap = self.caps.linear_m_s;
        self.note(now_ms, EventKind::Caps { index, middle, cap });
    }

    /// Returns the motion that the hand now requests of the tool;
    /// `None` means that the hand requests no motion.
    fn tool_m_s(&self, now_ms: u64) -> Option<DVec3> {
        let pointing = self.safety.jogging()?;
        Some(jog::tool_m_s(&self.jog, &self.drive, pointing, &self.lift, now_ms))
    }

    /// Requests this motion as often as the base's speed. Only the safety machine halts the arm.
    pub(super) fn move_tool(&mut self, due: bool, now_ms: u64, robot: &mut dyn Door) {
        let Some(tool_m_s) = self.tool_m_s(now_ms) else { return };
        if due || tool_m_s != self.jogged_m_s {
            self.jogged_m_s = tool_m_s;
            robot.jog(tool_m_s);
        }
    }
}
