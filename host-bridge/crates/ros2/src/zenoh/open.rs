//! Joins the graph on Zenoh: opens a session, creates subscriptions, publishers and clients, and declares tokens.

use std::collections::BTreeSet;
use std::sync::Arc;

use zenoh::sample::SampleKind;
use zenoh::{Config, Wait};

use super::action::{self, Client};
use super::inbox::{Inbox, Read, Which};
use super::outbox::{Outbox, Reader, listen};
use super::voice::ZenohVoice;
use super::waiting::{Order, Place};
use super::{Gripper, Known, TOKENS_MAX, Tokens, ZenohNode, lock, writer_of};
use crate::config::{ArmInterface, Connection, Ros2Config};
use crate::estop::Inputs;
use crate::grip::Meant;
use crate::transport::{ArmWay, NodeError, Opened};
use crate::zenoh_keys::{Named, Node, Quality, read_token, tokens_of};

/// Maximum number of the arm's goals that are remembered.
const GOALS_MAX: usize = 64;

/// A link without any data for this long is closed, in ms. Messages that the closed link had accepted are lost.
/// TCP delivers data even after many lost packets. The value is rmw_zenoh's; see docs/zenoh.
const LEASE_MS: &str = "60000";
/// A link that accepts no data for this long (in µs) is also closed.
/// No stop depends on this time, because base and arm have their own timeouts.
const PATIENCE_US: &str = "60000000";

/// Zenoh's own configuration.
fn configuration(config: &Ros2Config, connection: &Connection) -> Result<Config, NodeError> {
    let bad = |what: &str, error: &dyn std::fmt::Display| {
        NodeError(format!("Zenoh's configuration {what}: {error}; docs/sites.md shows one that works"))
    };
    if let Some(file) = &connection.zenoh_config {
        return Config::from_file(file).map_err(|error| bad(file, &error));
    }
    let mut zenoh = Config::default();
    let routers = serde_json::to_string(&config.zenoh_connect).unwrap_or_default();
    for (key, value) in [
        ("mode", "\"client\""),
        ("connect/endpoints", &*routers),
        ("scouting/multicast/enabled", "false"),
        ("transport/link/tx/lease", LEASE_MS),
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", PATIENCE_US),
    ] {
        zenoh.insert_json5(key, value).map_err(|error| bad(key, &error))?;
    }
    Ok(zenoh)
}

/// Joins the graph through a router.
///
/// # Errors
/// Returns [`NodeError`] if no router answers, or a name is not available.
pub fn open(config: &Ros2Config, connection: &Connection, publish_sim: bool) -> Result<Opened, NodeError> {
    let session = zenoh::open(configuration(config, connection)?).wait().map_err(|error| {
        NodeError(format!(
            "no Zenoh router can be reached ({error}): start one (`ros2 run rmw_zenoh_cpp rmw_zenohd`), or name it in \
             zenoh_connect in [ros2] (here {:?})",
            config.zenoh_connect
        ))
    })?;
    let node = Node {
        domain: connection.domain_id,
        session: session.zid().to_string(),
        namespace: config.namespace.clone(),
        name: config.node.clone(),
    };
    let failed = |what: &str, error: zenoh::Error| NodeError(format!("{what} failed on Zenoh: {error}"));

    let tokens = Tokens::default();
    let (known, own) = (Arc::clone(&tokens), node.session.clone());
    let watches = session
        .liveliness()
        .declare_subscriber(tokens_of(node.domain))
        .history(true)
        .callback(move |sample| {
            let token = sample.key_expr().as_str().to_owned();
            let mut known = lock(&known);
            if sample.kind() == SampleKind::Delete {
                known.remove(&token);
            } else if known.len() < TOKENS_MAX
                && let Some(told) = read_token(&token).filter(|told| told.session != own)
            {
                let writer = writer_of(&token);
                known.insert(token, Known { told, writer });
            }
        })
        .wait()
        .map_err(|error| failed("looking around", error))?;

    let inbox = Inbox::default();
    let plain = Quality { depth: config.depth, ..Quality::RELIABLE };
    let controller = config.resolve(&config.arm_controller);
    let follow = format!("{controller}/follow_joint_trajectory");
    let way = match config.arm {
        ArmInterface::None => ArmWay::None,
        ArmInterface::Topic | ArmInterface::Stream => ArmWay::Topic,
        ArmInterface::Action => ArmWay::Action,
    };
    let topic = |name: &str, kind: &str| Named::new(&config.resolve(name), kind);

    // Creates the subscriptions; an action's client creates its own.
    let mut read = vec![(Read::Clock, topic("/clock", "rosgraph_msgs/msg/Clock"))];
    if !publish_sim {
        read.push((Read::Base, topic(&config.odom, "nav_msgs/msg/Odometry")));
    }
    if way != ArmWay::None {
        let kind = "control_msgs/msg/JointTrajectoryControllerState";
        read.push((Read::Controller, Named::new(&format!("{controller}/controller_state"), kind)));
        if !publish_sim {
            read.push((Read::Arm, topic(&config.joint_states, "sensor_msgs/msg/JointState")));
        }
    }
    for (n, name) in config.watched.topics.iter().enumerate() {
        read.push((Read::Thing(n), Named::new(name, "geometry_msgs/msg/PoseStamped")));
    }
    let flags = Inputs::new(config);
    let flags = flags.topics().enumerate();
    let mut latched: Vec<(Read, Named)> =
        flags.map(|(n, name)| (Read::Flag(n), Named::new(name, "std_msgs/msg/Bool"))).collect();
    if way != ArmWay::None {
        latched.push((Read::Status(Which::Arm), action::status(&follow)));
    }
    let of_arm = |read: &Read| *read == Read::Status(Which::Arm) && way == ArmWay::Action;
    let read = read.iter().map(|(read, named)| (*read, named, plain));
    let kept = latched
        .iter()
        .filter(|(read, _)| !of_arm(read))
        .map(|(read, named)| (*read, named, Quality::LATCHED));
    let readers: Vec<Reader> = (1..)
        .zip(read.chain(kept))
        .map(|(id, end)| listen(&session, &node, &inbox, id, end).map_err(|error| failed(&end.1.name, error)))
        .collect::<Result<_, _>>()?;
    let here = session.liveliness().declare_token(node.token()).wait();
    let here = here.map_err(|error| failed("saying who is there", error))?;

    // Dropping these values may wait for the network, so only the outbox's threads drop them.
    let held = Box::new((readers, here, watches));
    let outbox = Outbox::start(session.clone(), &node, &inbox, held)?;
    let arm = (way == ArmWay::Action).then(|| {
        let ends = (inbox.clone(), outbox.clone());
        Client::new(Which::Arm, &follow, "FollowJointTrajectory", GOALS_MAX, &node, ends)
    });

    // Creates the publishers.
    let write = |place, named, quality| outbox.order(Order::Write(place, named, quality));
    let is_stamped = config.stamped.fixed().unwrap_or(true);
    write(Place::Diagnostics, topic(&config.diagnostics, "diagnostic_msgs/msg/DiagnosticArray"), plain);
    write(Place::Stopped, topic(&config.stopped, "std_msgs/msg/Bool"), Quality::LATCHED);
    if way == ArmWay::Topic {
        let name = format!("{controller}/joint_trajectory");
        let named = Named::new(&name, "trajectory_msgs/msg/JointTrajectory");
        write(Place::Trajectory, named, Quality { depth: 1, ..plain });
    }
    let has_description = publish_sim && !config.robot_description.is_empty();
    if publish_sim {
        write(Place::JointStates, topic(&config.joint_states, "sensor_msgs/msg/JointState"), plain);
        write(Place::Odometry, topic(&config.odom, "nav_msgs/msg/Odometry"), plain);
        write(Place::Frames, topic(&config.tf, "tf2_msgs/msg/TFMessage"), plain);
        if has_description {
            write(Place::Description, topic(&config.robot_description, "std_msgs/msg/String"), plain);
        }
    }

    let voice = ZenohVoice { outbox: outbox.clone(), has_simulator: publish_sim, has_description, states: 0 };
    let joined = ZenohNode {
        session,
        node,
        tokens,
        inbox,
        outbox,
        cmd_vel: config.resolve(&config.cmd_vel),
        quality: Quality { reliable: config.reliable, ..plain },
        is_stamped,
        way,
        controller,
        arm,
        gripper: Meant::new(config).map(|meant| Gripper {
            meant,
            joint: config.gripper_joint.clone(),
            server: None,
        }),
        latched,
        asked: BTreeSet::new(),
    };
    joined.declare_speed();
    Ok((Box::new(joined), Box::new(voice)))
}
