//! Tests every safety rule with real frames in virtual time.
//!
//! Labels by number: 1 up-down (home, releases), 2 to-fro (pick-up), 3 left-right (place).

mod support;

use host_bridge::bridge::Bridge;
use host_bridge::bridge::GestureOutcome::{Busy, Late, NotArmed, Released, Started};
use host_bridge::intent::MotionMap;
use host_bridge::safety::{Hand, PerHand, State};
use proptest::prelude::*;
use shared_proto::message::{Board, Heading, PROTOCOL_MAJOR, health};
use support::{LABELS, Rig, Virtual as _, hello, hello_of, model, pose};

/// Braking from 0.5 m/s at 1 m/s² takes 0.5 s, and the arm brakes within 0.33 s.
/// The remaining time is a margin for the frame in transit.
const REST_MS: u64 = 520;

#[test]
fn nothing_moves_before_neutral_was_seen() {
    let mut rig = Rig::empty();
    rig.left.heading = Heading::Forward;
    rig.connect(Hand::Left, 1);
    rig.run(2000);
    assert_eq!(rig.state(), State::Waiting);
    assert!(!rig.take_moved());
    rig.point(Heading::Between, 500);
    rig.point(Heading::Forward, 500);
    assert!(!rig.take_moved());
    rig.point(Heading::Neutral, 200);
    rig.point(Heading::Forward, 500);
    assert!(rig.speed_m_s() > 0.3);
}

#[test]
fn both_hands_must_be_neutral_at_once() {
    let mut rig = Rig::with(&[Hand::Left, Hand::Right]);
    rig.right.top = 2;
    rig.run(300); // left neutral, right busy
    rig.left.heading = Heading::Forward;
    rig.right.top = 0;
    rig.run(500); // right at rest, left tilted
    assert_eq!(rig.state(), State::Waiting);
    assert!(!rig.take_moved());
    rig.point(Heading::Neutral, 200);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn a_hand_that_was_announced_is_waited_for() {
    let mut rig = Rig::empty();
    rig.bridge = Bridge::new(MotionMap::default()).awaiting(Hand::Left).awaiting(Hand::Right);
    rig.connect(Hand::Right, 1);
    rig.run(1000);
    rig.gesture(2);
    assert_eq!(rig.state(), State::Waiting, "the hand that stops the robot is not there");
    assert!(!rig.take_moved());
    rig.connect(Hand::Left, 1);
    rig.run(200);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn one_hand_alone_is_enough_for_its_own_part() {
    let mut left = Rig::with(&[Hand::Left]);
    left.run(200);
    left.point(Heading::Left, 1000);
    assert!((left.robot.odometry().twist.angular_rad_s - 0.5).abs() < 1e-9);

    let mut right = Rig::with(&[Hand::Right]);
    right.run(200);
    right.gesture(2);
    assert_eq!(right.take_outcomes(), [Started("pick-up".into())]);
    assert!(right.arm_moves());
}

#[test]
fn silence_of_either_hand_halts_base_and_arm_within_250_ms_and_for_good() {
    for silent in [Hand::Left, Hand::Right] {
        let mut rig = Rig::armed();
        rig.gesture(2);
        rig.point(Heading::Forward, 1500);
        assert!(rig.speed_m_s() > 0.4 && rig.arm_moves());
        rig.talking[silent] = false;
        rig.run(225);
        assert_eq!(rig.bridge.twist().linear_m_s, 0.5, "not before 250 ms");
        rig.run(30);
        assert_eq!(rig.bridge.twist().linear_m_s, 0.0);
        assert_eq!(rig.state(), State::Stale);
        rig.run(REST_MS);
        assert!(rig.robot.at_rest());
        // The hand is connected again but still tilted.
        // The robot does not move, and the arm's motion is cancelled.
        rig.talking[silent] = true;
        rig.take_moved();
        rig.run(3000);
        assert!(!rig.take_moved());
        rig.point(Heading::Neutral, 200);
        assert_eq!(rig.state(), State::Armed);
        rig.run(1000);
        assert!(!rig.take_moved(), "arming alone moves nothing");
        rig.point(Heading::Forward, 100);
        assert!(rig.take_moved());
    }
}

#[test]
fn a_hand_that_never_sends_a_state_after_its_hello_holds_everything_still() {
    let mut rig = Rig::with(&[Hand::Left]);
    rig.run(200);
    rig.point(Heading::Forward, 500);
    rig.send(Hand::Right, &hello(Hand::Right, 1));
    rig.run(REST_MS);
    rig.take_moved();
    rig.point(Heading::Neutral, 1000);
    rig.point(Heading::Forward, 1000);
    assert!(!rig.take_moved());
    assert_eq!(rig.state(), State::Stale);
}

#[test]
fn a_hand_in_doubt_halts_at_once_and_a_default_calibration_does_not() {
    for bit in 0..7 {
        let flag = 1 << bit;
        for hand in [Hand::Left, Hand::Right] {
            let mut rig = Rig::armed();
            rig.point(Heading::Forward, 1000);
            match hand {
                Hand::Left => rig.left.health = flag,
                Hand::Right => rig.right.health = flag,
            }
            rig.run(40);
            let drives = rig.bridge.twist().linear_m_s > 0.0;
            assert_eq!(drives, flag == health::DEFAULT_CALIBRATION, "{hand} flag {flag:#x}");
            // The sensor works again, but the hand is still tilted.
            rig.left.health = 0;
            rig.right.health = 0;
            rig.run(1000);
            assert_eq!(rig.speed_m_s() > 0.0, flag == health::DEFAULT_CALIBRATION);
        }
    }
}

#[test]
fn a_right_hand_in_doubt_starts_no_motion() {
    let mut rig = Rig::armed();
    rig.right.health = health::GAP;
    rig.gesture(2);
    assert!(!rig.take_moved());
    assert_eq!(rig.take_outcomes(), [NotArmed]);
}

#[test]
fn states_older_than_250_ms_are_dropped_but_can_stop() {
    let mut rig = Rig::armed();
    rig.talking = [false, true].into();
    // The sample is tilted and arrives 251 ms later, when the hand already counts as silent.
    rig.left.heading = Heading::Forward;
    let late = rig.left_frame();
    rig.run(260);
    rig.send(Hand::Left, &late);
    rig.run(100);
    assert!(!rig.take_moved());
    assert_eq!(rig.bridge.drops().late_states, 1);

    rig.talking = [true, true].into();
    rig.point(Heading::Neutral, 200);
    assert_eq!(rig.state(), State::Armed);
    rig.left.stop = true;
    let late_stop = rig.left_frame();
    rig.left.stop = false;
    rig.talking.left = false;
    rig.run(300);
    rig.send(Hand::Left, &late_stop);
    assert_eq!(rig.state(), State::Stopped);
}

#[test]
fn a_burst_after_a_stall_is_not_replayed() {
    let mut rig = Rig::armed();
    rig.talking = [false, true].into();
    let mut stalled = Vec::new();
    for heading in [Heading::Forward, Heading::Backward, Heading::Forward, Heading::Forward] {
        rig.left.heading = heading;
        rig.left.index_bends = rig.left.index_bends.wrapping_add(3);
        stalled.extend(rig.left_frame());
        rig.run(500);
    }
    rig.send(Hand::Left, &stalled);
    rig.talking.left = true;
    rig.run(1000);
    assert!(!rig.take_moved());
    rig.point(Heading::Neutral, 200);
    assert_eq!(rig.bridge.caps().linear_m_s, 0.5, "bends of the stall do not count later");
}

/// Creates a rig with only a left hand on a fast link. The hand is tilted backward and is not armed.
fn tilted_backward() -> Rig {
    let mut rig = Rig::with(&[Hand::Left]);
    rig.point(Heading::Backward, 1000);
    assert_eq!(rig.state(), State::Waiting);
    rig
}

#[test]
fn one_neutral_frame_in_a_burst_does_not_arm() {
    let mut rig = tilted_backward();
    rig.talking.left = false;
    let mut burst = Vec::new();
    for k in 0..10 {
        rig.left.heading = if k == 0 { Heading::Neutral } else { Heading::Forward };
        burst.extend(rig.left_frame());
        rig.run(20);
    }
    rig.send(Hand::Left, &burst);
    rig.talking.left = true;
    rig.run(1000);
    assert!(!rig.take_moved());
    assert_eq!(rig.state(), State::Waiting);
}

#[test]
fn one_neutral_frame_and_then_a_gap_does_not_arm() {
    for gap_ms in [100, 140, 200, 240] {
        let mut rig = tilted_backward();
        rig.talking.left = false;
        rig.left.heading = Heading::Neutral;
        rig.send_left();
        rig.run(gap_ms);
        rig.talking.left = true;
        rig.point(Heading::Forward, 1000);
        assert!(!rig.take_moved(), "{gap_ms} ms");
        assert_eq!(rig.state(), State::Waiting);
    }
}

#[test]
fn two_neutral_frames_do_not_arm_however_far_apart_and_three_do() {
    let mut rig = tilted_backward();
    rig.talking.left = false;
    rig.left.heading = Heading::Neutral;
    rig.send_left();
    rig.run(120);
    rig.send_left();
    rig.run(60);
    assert_eq!(rig.state(), State::Waiting);
    rig.send_left();
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn a_stall_that_ends_in_neutral_frames_arms_only_after_100_ms_more() {
    let mut rig = tilted_backward();
    rig.talking.left = false;
    rig.left.heading = Heading::Neutral;
    let mut burst = Vec::new();
    for _ in 0..10 {
        burst.extend(rig.left_frame());
        rig.run(20);
    }
    // The 200 ms of neutral samples arrive only now, all at once.
    rig.send(Hand::Left, &burst);
    rig.talking.left = true;
    rig.run(90);
    assert_eq!(rig.state(), State::Waiting);
    rig.run(60);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn neutral_samples_from_before_a_stop_do_not_count_towards_its_release() {
    let mut rig = Rig::armed();
    rig.talking.left = false;
    let mut before = Vec::new();
    for _ in 0..6 {
        before.extend(rig.left_frame());
        rig.run(20);
    }
    let (now_ms, robot) = (rig.now_ms, &mut rig.robot);
    rig.bridge.stop_key(now_ms, robot);
    rig.send(Hand::Left, &before);
    rig.talking.left = true;
    rig.run(990);
    rig.gesture(1);
    assert_eq!(rig.state(), State::Stopped, "0.99 s of neutral at the gesture's end");
    rig.gesture(1);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn any_pause_of_the_process_needs_neutral_afterwards() {
    for pause_ms in [251, 1000, 5000, 60_000, 3_600_000] {
        let mut rig = Rig::armed();
        rig.point(Heading::Forward, 500);
        assert_eq!(rig.bridge.twist().linear_m_s, 0.5);
        // The program is stopped, frozen or suspended. The boards' clocks continue, but no data is read.
        rig.now_ms += pause_ms;
        rig.run(3000);
        assert_eq!(rig.bridge.twist().linear_m_s, 0.0, "after {pause_ms} ms");
        rig.point(Heading::Neutral, 300);
        rig.point(Heading::Forward, 100);
        assert_eq!(rig.bridge.twist().linear_m_s, 0.5, "after {pause_ms} ms");
    }
}

#[test]
fn neutral_counts_on_a_prompt_link_only() {
    let mut rig = tilted_backward();
    rig.answering.left = false;
    // The last reply is at most 100 ms old. A ping that waits for 125 ms therefore no longer counts as fast.
    rig.point(Heading::Backward, 240);
    rig.point(Heading::Neutral, 2000);
    assert_ne!(rig.state(), State::Armed);
    rig.answering.left = true;
    rig.run(300);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn a_burst_from_before_the_link_was_opened_starts_nothing() {
    let mut rig = Rig::empty();
    let mut burst = hello(Hand::Left, 1);
    for heading in [Heading::Neutral, Heading::Neutral, Heading::Forward] {
        rig.left.heading = heading;
        rig.now_ms += 100;
        burst.extend(rig.left_frame());
    }
    rig.now_ms += 5000;
    rig.send(Hand::Left, &burst);
    rig.run(1000);
    assert!(!rig.take_moved());
}

#[test]
fn lost_repeated_and_overtaken_frames_change_nothing() {
    let mut rig = Rig::armed();
    rig.talking = [false, true].into();
    rig.left.index_bends += 1;
    let lost = rig.left_frame();
    drop(lost);
    rig.run(20);
    rig.left.index_bends += 1;
    let frame = rig.left_frame();
    rig.send(Hand::Left, &frame);
    assert!((rig.bridge.caps().linear_m_s - 0.605).abs() < 1e-12, "the lost frame's bend is in this one");
    rig.send(Hand::Left, &frame);
    rig.send(Hand::Left, &frame);
    assert!((rig.bridge.caps().linear_m_s - 0.605).abs() < 1e-12);
    // An older frame contains forward. The newer frame has already arrived and contains neutral.
    rig.left.heading = Heading::Forward;
    let older = rig.left_frame();
    rig.left.heading = Heading::Neutral;
    let newer = rig.left_frame();
    rig.send(Hand::Left, &newer);
    rig.send(Hand::Left, &older);
    rig.run(20);
    assert!(!rig.take_moved());
    let counters = rig.bridge.link(Hand::Left).counters();
    // The overtaken frame was missing when the newer frame arrived. It therefore also counts as lost.
    assert_eq!((counters.lost, counters.duplicates, counters.overtaken), (2, 2, 1), "{counters:?}");
}

#[test]
fn damaged_bytes_are_counted_and_move_nothing() {
    let mut rig = Rig::armed();
    rig.talking = [false, true].into();
    rig.left.heading = Heading::Forward;
    let frame = rig.left_frame();
    for i in 0..frame.len() - 1 {
        let mut damaged = frame.clone();
        damaged[i] ^= 0x10;
        rig.send(Hand::Left, &damaged);
    }
    rig.run(10);
    assert!(!rig.take_moved());
    assert!(rig.bridge.link(Hand::Left).counters().damaged > 10);
    rig.left.heading = Heading::Neutral;
    rig.talking = [true, true].into();
    rig.run(200);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn a_restarted_board_needs_neutral_again_and_its_counters_start_anew() {
    let mut rig = Rig::armed();
    rig.left.index_bends = 200;
    rig.left.middle_bends = 200;
    rig.run(20);
    let cap = rig.bridge.caps().linear_m_s;
    rig.point(Heading::Forward, 1000);
    // The board restarts, so its clock, sequence number and counters start again at 0.
    rig.board_ahead_ms = 0_u32.wrapping_sub(rig.now_ms as u32);
    rig.left.sequence = 0;
    rig.left.index_bends = 5;
    rig.left.middle_bends = 7;
    rig.talking.right = false;
    rig.send(Hand::Left, &hello(Hand::Left, 2));
    rig.run(100);
    assert_eq!(rig.bridge.twist().linear_m_s, 0.0);
    assert_eq!(rig.state(), State::Waiting);
    assert_eq!(rig.bridge.caps().linear_m_s, cap);
}

#[test]
fn a_restart_whose_hello_was_lost_is_held_still_and_asked_for() {
    let mut rig = Rig::armed();
    rig.point(Heading::Forward, 1000);
    assert_eq!(rig.bridge.poll(Hand::Left, rig.now_ms), None);
    rig.board_ahead_ms = 0_u32.wrapping_sub(rig.now_ms as u32);
    rig.left.sequence = 60_000;
    rig.run(300);
    assert_eq!(rig.bridge.twist().linear_m_s, 0.0);
    rig.run(500);
    assert!(rig.bridge.poll(Hand::Left, rig.now_ms).is_some(), "asks for a hello");
}

#[test]
fn a_repeated_hello_of_the_same_start_disturbs_nothing() {
    let mut rig = Rig::armed();
    rig.point(Heading::Forward, 500);
    rig.send(Hand::Left, &hello(Hand::Left, 1));
    rig.send(Hand::Right, &hello(Hand::Right, 1));
    rig.send(Hand::Right, &model(LABELS));
    rig.run(50);
    assert_eq!(rig.state(), State::Armed);
    assert!(rig.speed_m_s() > 0.4);
}

#[test]
fn boards_of_another_version_or_the_other_hand_are_refused_with_advice() {
    for (bytes, advice) in [
        (hello_of(Board::LeftNano, 1, PROTOCOL_MAJOR + 1), "update host-bridge"),
        (hello_of(Board::RightNano33, 1, PROTOCOL_MAJOR), "swap the ports"),
    ] {
        let mut rig = Rig::empty();
        rig.send(Hand::Left, &bytes);
        rig.talking.left = true;
        rig.run(100);
        rig.point(Heading::Forward, 100);
        assert!(!rig.take_moved());
        assert!(!rig.bridge.safety().connected(Hand::Left));
        assert!(format!("{:?}", rig.events).contains(advice), "{:?}", rig.events);
    }
}

#[test]
fn states_before_a_hello_move_nothing() {
    let mut rig = Rig::empty();
    rig.talking = [true, true].into();
    rig.run(500);
    rig.point(Heading::Forward, 500);
    rig.gesture(2);
    assert!(!rig.take_moved());
    assert!(rig.bridge.link(Hand::Left).counters().before_hello > 0);
}

#[test]
fn stop_halts_base_and_arm_and_resets_the_caps() {
    let mut rig = Rig::armed();
    rig.left.index_bends += 3;
    rig.gesture(2);
    rig.point(Heading::Forward, 1500);
    assert!(rig.bridge.caps().linear_m_s > 0.6 && rig.arm_moves());
    rig.stop();
    assert_eq!(rig.state(), State::Stopped);
    assert_eq!(rig.bridge.caps().linear_m_s, 0.5);
    rig.run(REST_MS + 200);
    assert!(rig.robot.at_rest());
    // The stop is not released by a tilt, by neutral, by waiting, or by other gestures.
    rig.take_moved();
    rig.point(Heading::Forward, 1000);
    rig.point(Heading::Neutral, 5000);
    rig.take_outcomes();
    rig.gesture(3);
    assert_eq!(rig.take_outcomes(), [NotArmed]);
    assert_eq!(rig.state(), State::Stopped);
    assert!(!rig.take_moved());
}

#[test]
fn release_is_neutral_for_a_second_then_up_down_and_moves_nothing() {
    let mut rig = Rig::armed();
    rig.stop();
    rig.point(Heading::Neutral, 500);
    rig.gesture(1);
    assert_eq!(rig.take_outcomes(), [NotArmed], "too early");
    rig.run(500);
    rig.gesture(1);
    assert_eq!(rig.take_outcomes(), [Released]);
    assert_eq!(rig.state(), State::Armed);
    rig.run(3000);
    assert!(!rig.take_moved(), "release alone moves nothing");
    rig.gesture(1);
    assert_eq!(rig.take_outcomes(), [Started("home".into())]);
    assert!(rig.take_moved());
}

#[test]
fn neutral_must_be_unbroken_up_to_the_release() {
    let mut rig = Rig::armed();
    rig.stop();
    rig.point(Heading::Neutral, 1500);
    rig.point(Heading::Between, 40);
    rig.gesture(1);
    rig.point(Heading::Neutral, 900);
    rig.gesture(1);
    assert_eq!(rig.take_outcomes(), [NotArmed, NotArmed]);
    rig.run(300);
    rig.gesture(1);
    assert_eq!(rig.take_outcomes(), [Released]);
}

#[test]
fn the_second_of_neutral_counts_from_the_stop_not_from_before() {
    let mut rig = Rig::armed();
    rig.run(5000);
    rig.stop();
    rig.gesture(1);
    assert_eq!(rig.take_outcomes(), [NotArmed]);
}

#[test]
fn bends_and_gestures_of_a_stop_do_not_act_after_it() {
    let mut rig = Rig::armed();
    rig.stop();
    rig.left.index_bends += 4;
    rig.gesture(2);
    rig.run(1200);
    rig.gesture(1);
    assert_eq!(rig.take_outcomes(), [NotArmed, Released]);
    rig.run(2000);
    assert_eq!(rig.bridge.caps().linear_m_s, 0.5);
    assert!(!rig.take_moved());
}

#[test]
fn the_release_key_counts_only_without_a_right_hand() {
    let mut rig = Rig::with(&[Hand::Left]);
    rig.run(200);
    rig.stop();
    rig.point(Heading::Neutral, 500);
    rig.bridge.release_key(rig.now_ms, &mut rig.robot);
    assert_eq!(rig.state(), State::Stopped, "before a second of neutral");
    rig.run(700);
    rig.bridge.release_key(rig.now_ms, &mut rig.robot);
    assert_eq!(rig.state(), State::Armed);
    assert!(!rig.take_moved());

    let mut rig = Rig::armed();
    rig.stop();
    rig.run(2000);
    rig.bridge.release_key(rig.now_ms, &mut rig.robot);
    assert_eq!(rig.state(), State::Stopped);
    // Silence of the right hand does not change the result.
    rig.talking.right = false;
    rig.run(2000);
    rig.bridge.release_key(rig.now_ms, &mut rig.robot);
    assert_eq!(rig.state(), State::Stopped);
}

#[test]
fn a_stop_outlives_silence_restarts_and_reconnects() {
    let mut rig = Rig::armed();
    rig.stop();
    rig.talking = [false, false].into();
    rig.run(1000);
    rig.talking = [true, true].into();
    rig.connect(Hand::Left, 2);
    rig.connect(Hand::Right, 2);
    rig.run(3000);
    rig.point(Heading::Forward, 500);
    assert_eq!(rig.state(), State::Stopped);
    assert!(!rig.take_moved());
    rig.point(Heading::Neutral, 1200);
    rig.gesture(1);
    assert_eq!(rig.state(), State::Armed);
}

#[test]
fn a_stop_is_not_released_while_a_hand_is_silent() {
    let mut rig = Rig::armed();
    rig.stop();
    rig.run(2000);
    rig.talking.left = false;
    rig.run(300);
    rig.gesture(1);
    assert_eq!(rig.take_outcomes(), [NotArmed]);
    assert_eq!(rig.state(), State::Stopped);
}

#[test]
fn without_a_left_hand_a_stop_key_is_released_by_rest_and_up_down() {
    let mut rig = Rig::with(&[Hand::Right]);
    rig.run(200);
    rig.gesture(2);
    rig.run(1000);
    rig.bridge.stop_key(rig.now_ms, &mut rig.robot);
    rig.run(400);
    assert!(rig.robot.at_rest());
    rig.gesture(1);
    assert_eq!(rig.state(), State::Stopped);
    rig.run(1200);
    rig.take_moved();
    rig.gesture(1);
    assert_eq!(rig.state(), State::Armed);
    assert!(!rig.take_moved());
}

#[test]
fn a_gesture_while_a_motion_runs_is_dropped_counted_and_not_queued() {
    let mut rig = Rig::armed();
    rig.gesture(2);
    rig.run(1000);
    rig.gesture(3);
    assert_eq!(rig.take_outcomes(), [Started("pick-up".into()), Busy("pick-up".into())]);
    assert_eq!(rig.bridge.drops().gestures_while_busy, 1);
    rig.run(20_000);
    assert_eq!(rig.robot.arm().joints_rad, pose("pick-up"));
    assert!(rig.take_outcomes().is_empty());
}

#[test]
fn a_gesture_whose_window_ended_too_long_ago_is_dropped() {
    let mut rig = Rig::armed();
    rig.right.events += 1;
    rig.right.label = 2;
    rig.right.event_window_end_ms = rig.board_time_ms().wrapping_sub(300);
    rig.run(100);
    assert_eq!(rig.take_outcomes(), [Late]);
    // The next age is negative, which is not valid.
    rig.right.events += 1;
    rig.right.event_window_end_ms = rig.board_time_ms().wrapping_add(1000);
    rig.run(100);
    assert_eq!(rig.take_outcomes(), [Late]);
    assert!(!rig.take_moved());
}

#[test]
fn gestures_whose_frames_were_lost_are_acted_on_once_and_only_the_last() {
    let mut rig = Rig::armed();
    rig.right.events += 3;
    rig.right.label = 2;
    rig.right.event_window_end_ms = rig.board_time_ms();
    rig.run(100);
    assert_eq!(rig.take_outcomes(), [Started("pick-up".into())]);
    assert_eq!(rig.bridge.drops().gestures_unnamed, 2);
}

#[test]
fn a_gesture_before_the_model_is_known_or_outside_its_labels_does_nothing() {
    let mut rig = Rig::empty();
    rig.send(Hand::Right, &hello(Hand::Right, 1));
    rig.talking.right = true;
    rig.run(200);
    rig.gesture(2);
    assert!(rig.take_outcomes().is_empty());
    rig.send(Hand::Right, &model("idle,wave"));
    rig.run(200);
    rig.gesture(5);
    assert!(rig.take_outcomes().is_empty());
    assert!(!rig.take_moved());
}

#[test]
fn a_new_hand_halts_the_one_that_drives_until_both_are_neutral() {
    let mut rig = Rig::with(&[Hand::Left]);
    rig.run(200);
    rig.point(Heading::Forward, 1000);
    rig.connect(Hand::Right, 1);
    rig.run(REST_MS + 100);
    assert!(rig.robot.at_rest());
    rig.point(Heading::Neutral, 200);
    rig.point(Heading::Forward, 100);
    assert!(rig.take_moved());
}

/// An event in a random session.
#[derive(Clone, Debug)]
enum Step {
    Point(Heading),
    Bend(u8, u8),
    Stop,
    Gesture(u8),
    Silence(bool, bool),
    Health(u8, u8),
    Restart(Hand, u32),
    Garbage(Vec<u8>),
    Keys,
    Wait(u64),
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    use Heading::*;
    let heading = prop::sample::select(vec![Neutral, Neutral, Between, Forward, Backward, Left, Right]);
    let hand = prop::sample::select(vec![Hand::Left, Hand::Right]);
    let step = prop_oneof![
        6 => heading.prop_map(Step::Point),
        2 => (0..4_u8, 0..4_u8).prop_map(|(i, m)| Step::Bend(i, m)),
        1 => Just(Step::Stop),
        4 => (0..8_u8).prop_map(Step::Gesture),
        1 => any::<(bool, bool)>().prop_map(|(l, r)| Step::Silence(l, r)),
        1 => (0..128_u8, 0..128_u8).prop_map(|(l, r)| Step::Health(l, r)),
        1 => (hand, 1..4_u32).prop_map(|(h, b)| Step::Restart(h, b)),
        1 => prop::collection::vec(any::<u8>(), 0..60).prop_map(Step::Garbage),
        1 => Just(Step::Keys),
        8 => (1..2500_u64).prop_map(Step::Wait),
    ];
    prop::collection::vec(step, 1..60)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: cases(), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn whatever_happens_limits_hold_and_silence_leads_to_rest(steps in steps()) {
        let mut rig = Rig::with(&[Hand::Left, Hand::Right]);
        let mut check = Watch::new(&rig);
        for step in steps {
            match step {
                Step::Point(heading) => rig.left.heading = heading,
                Step::Bend(index, middle) => {
                    rig.left.index_bends = rig.left.index_bends.wrapping_add(index);
                    rig.left.middle_bends = rig.left.middle_bends.wrapping_add(middle);
                }
                Step::Stop => rig.left.stop = !rig.left.stop,
                Step::Gesture(label) => {
                    rig.right.events = rig.right.events.wrapping_add(1);
                    rig.right.label = label;
                    rig.right.event_window_end_ms = rig.board_time_ms();
                }
                Step::Silence(left, right) => rig.talking = PerHand { left, right },
                Step::Health(left, right) => {
                    // Most of the random values count as healthy.
                    rig.left.health = if left < 96 { 0 } else { left };
                    rig.right.health = if right < 96 { 0 } else { right };
                }
                Step::Restart(hand, boot_id) => rig.connect(hand, boot_id),
                Step::Garbage(bytes) => {
                    rig.send(Hand::Left, &bytes);
                    rig.send(Hand::Right, &bytes);
                }
                Step::Keys => {
                    rig.bridge.stop_key(rig.now_ms, &mut rig.robot);
                    rig.bridge.release_key(rig.now_ms, &mut rig.robot);
                }
                Step::Wait(ms) => check.run(&mut rig, ms)?,
            }
        }
        // Both hands fall silent. The robot must be at rest after 250 ms plus the braking time from full speed.
        rig.talking = [false, false].into();
        check.run(&mut rig, 250 + 1010)?;
        prop_assert!(rig.robot.at_rest());
        rig.take_moved();
        check.run(&mut rig, 2000)?;
        prop_assert!(!rig.take_moved());
    }
}

/// There are more sessions under `BIMANUAL_FULL=1`.
fn cases() -> u32 {
    if std::env::var_os("BIMANUAL_FULL").is_some() { 2000 } else { 100 }
}

/// Checks the robot every millisecond.
struct Watch {
    wheels: [f64; 2],
    joints: host_bridge::robot::Joints,
}

impl Watch {
    fn new(rig: &Rig) -> Self {
        Watch { wheels: rig.robot.wheels_rad_s(), joints: rig.robot.arm().velocity_rad_s }
    }

    fn run(&mut self, rig: &mut Rig, ms: u64) -> Result<(), TestCaseError> {
        let limits = host_bridge::arm::gen3::paper_limits();
        for _ in 0..ms {
            rig.run(1);
            let (wheels, arm, place) = (rig.robot.wheels_rad_s(), rig.robot.arm(), rig.robot.odometry());
            for (new, old) in wheels.iter().zip(self.wheels) {
                prop_assert!(new.abs() <= 10.0 + 1e-9, "a cap of 1 m/s on 10 cm wheels");
                prop_assert!((new - old).abs() <= 0.010 + 1e-9);
            }
            for i in 0..7 {
                prop_assert!(arm.velocity_rad_s[i].abs() <= limits.velocity_rad_s[i] * (1.0 + 1e-9));
                let change = (arm.velocity_rad_s[i] - self.joints[i]).abs();
                prop_assert!(change <= limits.acceleration_rad_s2[i] * 0.001 + 1e-9, "joint {i}: {change}");
            }
            prop_assert_eq!(host_bridge::arm::model::SerialArm::gen3().check(&arm.joints_rad), Ok(()));
            prop_assert!(place.x_m.is_finite() && place.y_m.is_finite() && place.heading_rad.is_finite());
            if rig.state() != State::Armed {
                prop_assert_eq!(rig.bridge.twist(), host_bridge::base::Twist::ZERO);
            }
            let cap = rig.bridge.caps().linear_m_s;
            prop_assert!((0.05..=1.0).contains(&cap));
            (self.wheels, self.joints) = (wheels, arm.velocity_rad_s);
        }
        Ok(())
    }
}
