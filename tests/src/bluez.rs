//! Simulates BlueZ, the system's Bluetooth service, on a private D-Bus.
//! The simulation implements only what is needed to find, connect and use one board. There is no radio.
//!
//! The board is any device on a serial port, such as an emulated board's pseudo-terminal.
//! Bytes from the board become notifications, and writes become input of the board.
//! While the port does not exist, the board is out of range.
//!
//! Objects, properties and errors have the same names as in BlueZ 5.66 (`doc/*-api.txt`).
//! After discovery, the adapter `hci0` contains the board, which contains its service with two characteristics.

use std::collections::{BTreeMap, HashMap};
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use dbus::Message;
use dbus::arg::{PropMap, RefArg, Variant};
use dbus::blocking::stdintf::org_freedesktop_dbus::{
    ObjectManagerInterfacesAdded, PropertiesPropertiesChanged,
};
use dbus::channel::Channel;
use dbus::message::{MessageType, SignalArgs as _};
use serialport::SerialPort;

const ADAPTER: &str = "org.bluez.Adapter1";
const DEVICE: &str = "org.bluez.Device1";
const SERVICE: &str = "org.bluez.GattService1";
const CHARACTERISTIC: &str = "org.bluez.GattCharacteristic1";
const PROPERTIES: &str = "org.freedesktop.DBus.Properties";

const HCI: &str = "/org/bluez/hci0";
const BOARD: &str = "/org/bluez/hci0/dev_C0_FF_EE_00_00_33";
const HAND: &str = "/org/bluez/hci0/dev_C0_FF_EE_00_00_33/service0010";
const OUT: &str = "/org/bluez/hci0/dev_C0_FF_EE_00_00_33/service0010/char0011";
const IN: &str = "/org/bluez/hci0/dev_C0_FF_EE_00_00_33/service0010/char0014";

/// The UUIDs are the same as in `firmware-nano33/src/ble.rs`.
const UUID: &str = "b1a40001-6d61-4e75-a1b2-5c3d9e7f0a33";
const OUT_UUID: &str = "b1a40002-6d61-4e75-a1b2-5c3d9e7f0a33";
const IN_UUID: &str = "b1a40003-6d61-4e75-a1b2-5c3d9e7f0a33";
/// The board's MTU, which limits the length of a notification.
const MTU: u16 = 247;
const NOTIFICATION: usize = 244;

#[derive(Clone, Debug)]
enum Value {
    Text(&'static str),
    Texts(Vec<&'static str>),
    Flag(bool),
    Small(i16),
    Size(u16),
    ObjectPath(&'static str),
    Bytes(Vec<u8>),
}

impl Value {
    fn variant(&self) -> Variant<Box<dyn RefArg>> {
        let value: Box<dyn RefArg> = match self.clone() {
            Value::Text(text) => Box::new(text.to_owned()),
            Value::Texts(texts) => Box::new(texts.into_iter().map(str::to_owned).collect::<Vec<_>>()),
            Value::Flag(flag) => Box::new(flag),
            Value::Small(number) => Box::new(number),
            Value::Size(number) => Box::new(number),
            Value::ObjectPath(path) => Box::new(dbus::Path::from(path)),
            Value::Bytes(bytes) => Box::new(bytes),
        };
        Variant(value)
    }
}

type Properties = BTreeMap<&'static str, Value>;

fn map(properties: &Properties) -> PropMap {
    properties.iter().map(|(name, value)| ((*name).to_owned(), value.variant())).collect()
}

enum Order {
    Power(bool),
    Pair(bool),
    End,
}

/// A private D-Bus.
pub struct Bus {
    daemon: Child,
    /// The value for `DBUS_SYSTEM_BUS_ADDRESS`.
    pub address: String,
}

impl Bus {
    /// Starts a `dbus-daemon` with its own configuration in this folder.
    ///
    /// # Panics
    /// Panics if `dbus-daemon` is not installed (Debian: package dbus-daemon).
    pub fn start(folder: &Path) -> Self {
        let config = folder.join("bus.conf");
        let socket = folder.join("bus");
        let text = format!(
            "<busconfig><type>system</type><listen>unix:path={}</listen><auth>EXTERNAL</auth>\
             <policy context='default'><allow send_destination='*' eavesdrop='true'/>\
             <allow eavesdrop='true'/><allow own='*'/></policy></busconfig>",
            socket.display()
        );
        std::fs::write(&config, text).expect("a file");
        let mut daemon = Command::new("dbus-daemon")
            .arg(format!("--config-file={}", config.display()))
            .args(["--nofork", "--nopidfile", "--print-address=1"])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("dbus-daemon starts (Debian: package dbus-daemon)");
        let mut address = String::new();
        let out = daemon.stdout.as_mut().expect("a pipe");
        BufReader::new(out).read_line(&mut address).expect("its address");
        Self { daemon, address: address.trim().to_owned() }
    }
}

impl Drop for Bus {
    fn drop(&mut self) {
        let _ = self.daemon.kill();
        let _ = self.daemon.wait();
    }
}

/// The simulated service on a bus.
pub struct Bluez {
    orders: Sender<Order>,
    thread: Option<JoinHandle<()>>,
}

impl Bluez {
    /// Starts the service with one enabled adapter and one paired board in range.
    /// The board's bytes come from the serial port at `air`.
    ///
    /// # Panics
    /// Panics if the bus does not accept the service.
    pub fn start(bus: &Bus, air: &Path) -> Self {
        let (orders, received) = channel();
        let (ready, is_ready) = channel();
        let (address, air) = (bus.address.clone(), air.to_path_buf());
        let thread = std::thread::spawn(move || {
            let mut service = Service::new(&address, air);
            let _ = ready.send(());
            service.run(&received);
        });
        is_ready.recv().expect("the service starts");
        Self { orders, thread: Some(thread) }
    }

    /// Switches Bluetooth on or off.
    pub fn power(&self, on: bool) {
        self.orders.send(Order::Power(on)).expect("the service runs");
    }

    /// Pairs or removes the board.
    pub fn pair(&self, paired: bool) {
        self.orders.send(Order::Pair(paired)).expect("the service runs");
    }
}

impl Drop for Bluez {
    fn drop(&mut self) {
        let _ = self.orders.send(Order::End);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

struct Service {
    channel: Channel,
    air: PathBuf,
    board: Option<Box<dyn SerialPort>>,
    objects: BTreeMap<&'static str, BTreeMap<&'static str, Properties>>,
    paired: bool,
}

impl Service {
    fn new(address: &str, air: PathBuf) -> Self {
        let mut channel = Channel::open_private(address).expect("a bus");
        channel.register().expect("a bus");
        let ask = Message::call_with_args(
            "org.freedesktop.DBus",
            "/org/freedesktop/DBus",
            "org.freedesktop.DBus",
            "RequestName",
            ("org.bluez", 0u32),
        );
        channel.send_with_reply_and_block(ask, Duration::from_secs(10)).expect("the name");
        let adapter = Properties::from([
            ("Address", Value::Text("00:11:22:33:44:55")),
            ("AddressType", Value::Text("public")),
            ("Name", Value::Text("double")),
            ("Alias", Value::Text("double")),
            ("Modalias", Value::Text("usb:v1D6Bp0246d0542")),
            ("Powered", Value::Flag(true)),
            ("Discovering", Value::Flag(false)),
        ]);
        let objects = BTreeMap::from([(HCI, BTreeMap::from([(ADAPTER, adapter)]))]);
        Self { channel, air, board: None, objects, paired: true }
    }

    fn run(&mut self, orders: &Receiver<Order>) {
        loop {
            while let Ok(order) = orders.try_recv() {
                match order {
                    Order::Power(on) => self.power(on),
                    Order::Pair(paired) => self.paired = paired,
                    Order::End => return,
                }
            }
            if let Ok(Some(message)) = self.channel.blocking_pop_message(Duration::from_millis(2))
                && message.msg_type() == MessageType::MethodCall
            {
                let reply = self.answer(&message);
                let _ = self.channel.send(reply);
            }
            self.advertise();
            self.notify();
            self.channel.flush();
        }
    }

    fn flag(&self, object: &str, interface: &str, name: &str) -> bool {
        let value = self.objects.get(object).and_then(|o| o.get(interface)).and_then(|p| p.get(name));
        matches!(value, Some(Value::Flag(true)))
    }

    /// Changes a property and notifies all listeners; `None` removes it.
    fn set(
        &mut self,
        object: &'static str,
        interface: &'static str,
        name: &'static str,
        value: Option<Value>,
    ) {
        let Some(properties) = self.objects.get_mut(object).and_then(|o| o.get_mut(interface)) else {
            return;
        };
        let mut changed = PropertiesPropertiesChanged {
            interface_name: interface.to_owned(),
            changed_properties: HashMap::new(),
            invalidated_properties: Vec::new(),
        };
        match value {
            Some(value) => {
                changed.changed_properties.insert(name.to_owned(), value.variant());
                properties.insert(name, value);
            }
            None => {
                changed.invalidated_properties.push(name.to_owned());
                properties.remove(name);
            }
        }
        let _ = self.channel.send(changed.to_emit_message(&object.into()));
    }

    fn add(&mut self, object: &'static str, interface: &'static str, properties: Properties) {
        let added = ObjectManagerInterfacesAdded {
            object: object.into(),
            interfaces: HashMap::from([(interface.to_owned(), map(&properties))]),
        };
        self.objects.insert(object, BTreeMap::from([(interface, properties)]));
        let _ = self.channel.send(added.to_emit_message(&"/".into()));
    }

    fn power(&mut self, on: bool) {
        if !on {
            self.disconnected();
            self.set(HCI, ADAPTER, "Discovering", Some(Value::Flag(false)));
        }
        self.set(HCI, ADAPTER, "Powered", Some(Value::Flag(on)));
    }

    /// Adds a board in range while a program scans.
    fn advertise(&mut self) {
        let heard = self.flag(HCI, ADAPTER, "Discovering") && self.air.exists();
        let known = self.objects.contains_key(BOARD);
        if heard && !known {
            let properties = Properties::from([
                ("Address", Value::Text("C0:FF:EE:00:00:33")),
                ("AddressType", Value::Text("random")),
                ("Name", Value::Text("bimanual-right")),
                ("Alias", Value::Text("bimanual-right")),
                ("Adapter", Value::ObjectPath(HCI)),
                ("UUIDs", Value::Texts(vec![UUID])),
                ("Paired", Value::Flag(self.paired)),
                ("Trusted", Value::Flag(false)),
                ("Blocked", Value::Flag(false)),
                ("LegacyPairing", Value::Flag(false)),
                ("Connected", Value::Flag(false)),
                ("ServicesResolved", Value::Flag(false)),
                ("RSSI", Value::Small(-57)),
            ]);
            self.add(BOARD, DEVICE, properties);
        } else if known {
            let has_rssi = self.objects[BOARD][DEVICE].contains_key("RSSI");
            if heard != has_rssi {
                self.set(BOARD, DEVICE, "RSSI", heard.then_some(Value::Small(-57)));
            }
        }
    }

    fn connected(&mut self, port: Box<dyn SerialPort>) {
        self.board = Some(port);
        self.set(BOARD, DEVICE, "Connected", Some(Value::Flag(true)));
        let service = Properties::from([
            ("UUID", Value::Text(UUID)),
            ("Primary", Value::Flag(true)),
            ("Device", Value::ObjectPath(BOARD)),
        ]);
        self.add(HAND, SERVICE, service);
        for (place, uuid, flags) in
            [(OUT, OUT_UUID, vec!["notify"]), (IN, IN_UUID, vec!["write-without-response", "write"])]
        {
            let characteristic = Properties::from([
                ("UUID", Value::Text(uuid)),
                ("Service", Value::ObjectPath(HAND)),
                ("Flags", Value::Texts(flags)),
                ("Notifying", Value::Flag(false)),
                ("MTU", Value::Size(MTU)),
                ("Value", Value::Bytes(Vec::new())),
            ]);
            self.add(place, CHARACTERISTIC, characteristic);
        }
        self.set(BOARD, DEVICE, "ServicesResolved", Some(Value::Flag(true)));
    }

    fn disconnected(&mut self) {
        if self.board.take().is_some() {
            for place in [IN, OUT, HAND] {
                self.objects.remove(place);
            }
            self.set(BOARD, DEVICE, "ServicesResolved", Some(Value::Flag(false)));
            self.set(BOARD, DEVICE, "Connected", Some(Value::Flag(false)));
        }
    }

    /// Sends the board's bytes as notifications.
    fn notify(&mut self) {
        let Some(port) = &mut self.board else { return };
        let mut buffer = [0; NOTIFICATION];
        match port.read(&mut buffer) {
            Ok(count) if count > 0 => {
                if self.flag(OUT, CHARACTERISTIC, "Notifying") {
                    self.set(OUT, CHARACTERISTIC, "Value", Some(Value::Bytes(buffer[..count].to_vec())));
                }
            }
            Err(error) if error.kind() == std::io::ErrorKind::TimedOut => {}
            // The board is out of range.
            _ => self.disconnected(),
        }
    }

    fn answer(&mut self, message: &Message) -> Message {
        let text = |part: Option<String>| part.unwrap_or_default();
        let path = text(message.path().map(|p| p.to_string()));
        let member = text(message.member().map(|m| m.to_string()));
        let interface = text(message.interface().map(|i| i.to_string()));
        let done = || message.method_return();
        match (interface.as_str(), member.as_str()) {
            ("org.freedesktop.DBus.ObjectManager", "GetManagedObjects") => {
                let tree: HashMap<dbus::Path<'static>, HashMap<String, PropMap>> = self
                    .objects
                    .iter()
                    .map(|(path, interfaces)| {
                        let interfaces = interfaces.iter().map(|(name, p)| ((*name).to_owned(), map(p)));
                        (dbus::Path::from(*path), interfaces.collect())
                    })
                    .collect();
                message.method_return().append1(tree)
            }
            ("org.freedesktop.DBus.Introspectable", "Introspect") => {
                message.method_return().append1(self.introspected(&path))
            }
            (PROPERTIES, "GetAll") => {
                let (Some(object), Ok(name)) = (self.objects.get(path.as_str()), message.read1::<&str>())
                else {
                    return unknown(message);
                };
                object.get(name).map_or_else(|| unknown(message), |p| message.method_return().append1(map(p)))
            }
            (PROPERTIES, "Get") => {
                let Ok((interface, name)) = message.read2::<&str, &str>() else { return unknown(message) };
                let object = self.objects.get(path.as_str()).and_then(|o| o.get(interface));
                let value = object.and_then(|properties| properties.get(name));
                value.map_or_else(|| unknown(message), |v| message.method_return().append1(v.variant()))
            }
            // btleplug enables a disabled adapter before it scans, but our program must not enable it.
            (PROPERTIES, "Set") if self.flag(HCI, ADAPTER, "Powered") => done(),
            (PROPERTIES, "Set") => failed(message, "org.bluez.Error.Blocked", c"Blocked through rfkill"),
            (ADAPTER, "SetDiscoveryFilter") => done(),
            (ADAPTER, "StartDiscovery") => {
                self.set(HCI, ADAPTER, "Discovering", Some(Value::Flag(true)));
                done()
            }
            (ADAPTER, "StopDiscovery") => {
                self.set(HCI, ADAPTER, "Discovering", Some(Value::Flag(false)));
                done()
            }
            (DEVICE, "Connect") => {
                let port =
                    serialport::new(self.air.to_string_lossy(), 115_200).timeout(Duration::from_millis(1));
                match port.open() {
                    Ok(port) => {
                        self.connected(port);
                        done()
                    }
                    Err(_) => failed(message, "org.bluez.Error.Failed", c"le-connection-abort-by-local"),
                }
            }
            (DEVICE, "Disconnect") => {
                self.disconnected();
                done()
            }
            (CHARACTERISTIC, "StartNotify") if path == OUT => {
                self.set(OUT, CHARACTERISTIC, "Notifying", Some(Value::Flag(true)));
                done()
            }
            (CHARACTERISTIC, "StopNotify") => {
                self.set(OUT, CHARACTERISTIC, "Notifying", Some(Value::Flag(false)));
                done()
            }
            (CHARACTERISTIC, "WriteValue") if path == IN => {
                if !self.paired {
                    return failed(message, "org.bluez.Error.NotPermitted", c"Not paired");
                }
                let bytes: Vec<u8> = message.read1().unwrap_or_default();
                assert!(bytes.len() <= usize::from(MTU - 3), "a write of {} bytes", bytes.len());
                if self.board.as_mut().is_some_and(|port| port.write_all(&bytes).is_ok()) {
                    done()
                } else {
                    failed(message, "org.bluez.Error.Failed", c"Not connected")
                }
            }
            _ => unknown(message),
        }
    }

    fn introspected(&self, path: &str) -> String {
        let below = format!("{}/", path.trim_end_matches('/'));
        let children = self.objects.keys().filter_map(|object| object.strip_prefix(&below));
        let nodes: String = children
            .filter(|name| !name.contains('/'))
            .map(|name| format!("<node name=\"{name}\"/>"))
            .collect();
        format!("<node>{nodes}</node>")
    }
}

fn failed(message: &Message, name: &str, text: &std::ffi::CStr) -> Message {
    message.error(&name.into(), text)
}

fn unknown(message: &Message) -> Message {
    failed(message, "org.freedesktop.DBus.Error.UnknownMethod", c"there is no such thing")
}
