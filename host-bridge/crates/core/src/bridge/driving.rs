//! The base's side of the bridge: what a left hand's state changes, and the speed that is requested.

use host_robot::{Door, Part};
use shared_proto::message::{LeftState, health};

use super::judged::command;
use super::{Bridge, EventKind};
use crate::safety::{self, State};
use crate::tilt::Tilt;

impl Bridge {
    /// Requests the current speed of the base.
    pub(super) fn drive(&mut self, now_ms: u64, robot: &mut dyn Door) {
        let twist = self.twist();
        self.driven = (twist, now_ms);
        robot.cap(self.caps.linear_m_s);
        robot.drive(twist);
    }

    /// Processes a left hand's state, with the new bends of index and middle finger.
    /// In one-handed mode, the state comes from the right hand.
    pub(super) fn left(
        &mut self,
        age_ms: u64,
        state: LeftState,
        [index_bends, middle_bends]: [u8; 2],
        now_ms: u64,
        robot: &mut dyn Door,
    ) {
        let before = command(self.safety.heading());
        let hand = self.driving_hand();
        let event = safety::Event::Left {
            age_ms,
            prompt: self.links[hand].is_prompt(self.safety.times().prompt_ms(), now_ms),
            healthy: health::is_fit(state.health),
            heading: state.heading,
            tilt: Tilt { pitch_mrad: state.pitch_mrad, roll_mrad: state.roll_mrad },
            index_bends,
            middle_bends,
            stop: state.stop,
        };
        self.left_state = state;
        self.apply(event, now_ms, robot);
        let heading = self.safety.heading();
        // A halt is reported as a separate event.
        if self.safety.state() == State::Armed && command(heading) != before {
            let event = EventKind::Heading {
                hand,
                heading,
                twist: self.twist(),
                sample_board_ms: state.board_time_ms,
                age_ms,
            };
            self.note(now_ms, event);
            self.acceptances.ask(Part::Base, age_ms, now_ms);
        }
    }
}
