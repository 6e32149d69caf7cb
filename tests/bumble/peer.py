"""Bumble as the air and the laptop of emulated boards, in step with their virtual time.

The tests (`tests/src/nrf/controller/air.rs`) write requests to the standard input: what is asked (1 byte), by which board
(1), the time in cycles of 64 MHz (8), the length of the content (4), the content. For each one comes an answer: the time of
the next timer (8), how much follows (4), and per piece for whom it is (1: a board, or 255 for what the laptop did and
noticed, in JSON), its length (4) and itself. Nothing here knows the time of day.

Ours in place of bumble: the time of the link (the boards' side), parameters of a new connection at the peripheral (bumble
says 12.5 ms and 100 ms whatever the central asked for), scan responses (bumble repeats the advertisement), what a reset
does to a connection, and the end of a connection that nobody hears.
"""

import asyncio
import json
import logging
import random
import struct
import sys
import traceback

from bumble import core, hci
from bumble.controller import Controller
from bumble.device import ConnectionParametersPreferences, Device, DeviceConfiguration, Peer
from bumble.host import Host
from bumble.keys import MemoryKeyStore
from bumble.link import LocalLink
from bumble.pairing import PairingConfig, PairingDelegate
from bumble.transport.common import AsyncPipeSink

HZ = 64_000_000
NEVER = 2**64 - 1
PACKETS, LOST, SILENT, LAPTOP = range(4)
TIMEOUT = hci.HCI_ErrorCode.CONNECTION_TIMEOUT_ERROR
SCAN_RESPONSE = hci.HCI_LE_Extended_Advertising_Report_Event.EventType.SCAN_RESPONSE


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop whose time stands still until it is told."""

    now = 0.0

    def time(self):
        return self.now

    def next_timer(self):
        times = [handle.when() for handle in self._scheduled if not handle.cancelled()]
        return min(times, default=None)

    def settle(self):
        """Does all that is due, and never waits."""
        while True:
            self.call_soon(self.stop)
            self.run_forever()
            timer = self.next_timer()
            if not self._ready and (timer is None or timer > self.now):
                return


class Board(Controller):
    """The controller at a board's HCI."""

    def __init__(self, number, link):
        super().__init__(f"board {number}", link=link, public_address=f"C0:FF:EE:00:00:0{number}")
        self.number = number
        self.host = self

    # What goes to the board's host.
    def on_packet(self, packet):
        answer.append((self.number, bytes(packet)))

    def from_board(self, packet):
        super().on_packet(packet)

    def on_le_connect_ind(self, packet):
        self.asked = packet
        super().on_le_connect_ind(packet)

    def send_hci_packet(self, packet):
        if isinstance(packet, hci.HCI_LE_Connection_Complete_Event):
            packet = hci.HCI_LE_Connection_Complete_Event(
                status=packet.status,
                connection_handle=packet.connection_handle,
                role=packet.role,
                peer_address_type=packet.peer_address_type,
                peer_address=packet.peer_address,
                connection_interval=self.asked.interval,
                peripheral_latency=self.asked.latency,
                supervision_timeout=self.asked.timeout,
                central_clock_accuracy=7,
            )
        # At once, so that nothing overtakes anything.
        answer.append((self.number, bytes(packet)))

    def is_legacy_address(self, address):
        return self.le_legacy_advertiser.enabled and self.le_legacy_advertiser.address == address


class Laptop(Controller):
    """The controller in the laptop."""

    def send_hci_packet(self, packet):
        if isinstance(packet, hci.HCI_LE_Extended_Advertising_Report_Event):
            for report in packet.reports:
                if report.event_type & SCAN_RESPONSE == SCAN_RESPONSE:
                    for board in boards:
                        if board.is_legacy_address(report.address):
                            report.data = bytes(board.le_legacy_advertiser.scan_response_data)
            packet = hci.HCI_LE_Extended_Advertising_Report_Event(packet.reports)
        super().send_hci_packet(packet)


class Delegate(PairingDelegate):
    """Whoever sits at the laptop says yes to what the laptop shows, and types what a test tells (`do_type`)."""

    typed = None

    async def confirm(self, auto=False):
        note(asked="confirm")
        return True

    async def compare_numbers(self, number, digits=6):
        note(asked="compare", number=number)
        return True

    async def display_number(self, number, digits=6):
        note(asked="display", number=number)

    async def get_number(self):
        note(asked="enter")
        Delegate.typed = asyncio.get_running_loop().create_future()
        return await Delegate.typed


answer = []
boards = []


def note(**what):
    answer.append((255, json.dumps(what).encode()))


class Desk:
    """The laptop: one device, and what tests let it do."""

    def __init__(self, link):
        self.link = link
        self.keys = MemoryKeyStore()
        self.device = None
        self.connections = {}
        self.peers = {}
        self.io = "none"
        self.secure = True
        self.bonds = True
        self.tasks = set()
        self.epoch = 0

    async def start(self):
        """As after the laptop was switched on: a new device with the kept keys."""
        self.epoch += 1
        self.connections, self.peers = {}, {}
        controller = Laptop(f"laptop {self.epoch}", link=self.link, public_address="F0:F1:F2:F3:F4:F5")
        # A laptop's controller takes whole packets.
        controller.le_acl_data_packet_length = 251
        host = Host(controller, AsyncPipeSink(controller))
        configuration = DeviceConfiguration(name="laptop", address=hci.Address("F0:F1:F2:F3:F4:F5"))
        self.device = Device(config=configuration, host=host)
        self.controller = controller
        self.device.pairing_config_factory = self.pairing
        await self.device.power_on()
        self.device.keystore = self.keys

    def pairing(self, _connection):
        capabilities = {
            "none": PairingDelegate.IoCapability.NO_OUTPUT_NO_INPUT,
            "display": PairingDelegate.IoCapability.DISPLAY_OUTPUT_AND_YES_NO_INPUT,
            "keyboard": PairingDelegate.IoCapability.DISPLAY_OUTPUT_AND_KEYBOARD_INPUT,
        }
        return PairingConfig(
            sc=self.secure,
            mitm=self.io != "none",
            bonding=self.bonds,
            # The address that it connects from: bumble's link knows random ones only.
            identity_address_type=PairingConfig.AddressType.RANDOM,
            delegate=Delegate(io_capability=capabilities[self.io]),
        )

    def order(self, order):
        task = asyncio.get_running_loop().create_task(self.run(order))
        self.tasks.add(task)
        task.add_done_callback(self.tasks.discard)

    async def run(self, order):
        try:
            outcome = await getattr(self, "do_" + order["do"])(order)
            note(id=order["id"], done=outcome)
        except asyncio.CancelledError:
            note(id=order["id"], failed="cancelled")
        except Exception as error:  # Whatever bumble raises is an outcome.
            if order.get("trace"):
                traceback.print_exc()
            note(id=order["id"], failed=f"{type(error).__name__}: {error}", code=getattr(error, "error_code", None))

    def board(self, order):
        return order.get("board", 0)

    def connection(self, order):
        connection = self.connections.get(self.board(order))
        if connection is None:
            raise core.InvalidStateError("not connected")
        return connection

    async def do_configure(self, order):
        self.io = order.get("io", self.io)
        self.secure = order.get("secure", self.secure)
        self.bonds = order.get("bonds", self.bonds)

    async def do_restart(self, _order):
        """The laptop is switched off without a word and on again."""
        old = self.controller
        self.link.remove_controller(old)
        self.device = None
        await self.start()

    async def do_scan(self, order):
        heard = {}

        def on_advertisement(advertisement):
            entry = heard.setdefault(str(advertisement.address), {"names": [], "services": [], "count": 0, "rssi": None})
            entry["count"] += 1
            entry["rssi"] = advertisement.rssi
            data = advertisement.data
            name = data.get(core.AdvertisingData.COMPLETE_LOCAL_NAME) or data.get(core.AdvertisingData.SHORTENED_LOCAL_NAME)
            if name and name not in entry["names"]:
                entry["names"].append(name)
            for kind in (
                core.AdvertisingData.COMPLETE_LIST_OF_128_BIT_SERVICE_CLASS_UUIDS,
                core.AdvertisingData.INCOMPLETE_LIST_OF_128_BIT_SERVICE_CLASS_UUIDS,
            ):
                for uuid in data.get(kind) or []:
                    if str(uuid) not in entry["services"]:
                        entry["services"].append(str(uuid))

        self.device.on("advertisement", on_advertisement)
        await self.device.start_scanning(filter_duplicates=False)
        await asyncio.sleep(order["seconds"])
        await self.device.stop_scanning()
        self.device.remove_listener("advertisement", on_advertisement)
        return heard

    async def do_connect(self, order):
        number = self.board(order)
        board = boards[number]
        advertiser = board.le_legacy_advertiser
        address = advertiser.address
        for advertising_set in board.advertising_sets.values():
            if advertising_set.enabled:
                address = advertising_set.address
        interval, latency, supervision = order.get("interval", 15.0), order.get("latency", 0), order.get("supervision", 2000)
        connection = await self.device.connect(
            hci.Address(str(address), address.address_type),
            transport=core.PhysicalTransport.LE,
            connection_parameters_preferences={
                hci.Phy.LE_1M: ConnectionParametersPreferences(
                    connection_interval_min=interval,
                    connection_interval_max=interval,
                    max_latency=latency,
                    supervision_timeout=supervision,
                )
            },
            timeout=order.get("timeout", 10),
        )
        self.connections[number] = connection
        self.peers[number] = Peer(connection)

        def on_disconnection(reason):
            if self.connections.get(number) is connection:
                self.connections.pop(number, None)
                self.peers.pop(number, None)
            note(board=number, lost=int(reason))

        connection.on("disconnection", on_disconnection)
        connection.on(
            "connection_parameters_update",
            lambda: note(board=number, interval=connection.parameters.connection_interval),
        )
        connection.on(
            "security_request", lambda *_: note(board=number, security_request=True)
        )
        return {"peer": str(connection.peer_address), "interval": connection.parameters.connection_interval}

    async def do_disconnect(self, order):
        await self.connection(order).disconnect()

    async def do_pair(self, order):
        connection = self.connection(order)
        await connection.pair()
        return {"encrypted": bool(connection.encryption), "sc": bool(connection.sc), "authenticated": connection.authenticated}

    async def do_type(self, order):
        Delegate.typed.set_result(order["number"])

    async def do_encrypt(self, order):
        connection = self.connection(order)
        await connection.encrypt()
        return {"encrypted": bool(connection.encryption)}

    async def do_bonds(self, order):
        """With the board that is connected, or else with any."""
        connection = self.connections.get(self.board(order))
        address = str(connection.peer_address)[:17] if connection else ""
        return [name for name, _ in await self.keys.get_all() if name.startswith(address)]

    async def do_forget(self, _order):
        for name, _ in await self.keys.get_all():
            await self.keys.delete(name)

    async def do_mtu(self, order):
        return await self.peers[self.board(order)].request_mtu(order["mtu"])

    async def do_parameters(self, order):
        interval = order["interval"]
        await self.connection(order).update_parameters(interval, interval, order.get("latency", 0), order.get("supervision", 2000))

    async def do_discover(self, order):
        peer = self.peers[self.board(order)]
        await peer.discover_services()
        await peer.discover_characteristics()
        return {
            str(service.uuid): {str(c.uuid): [c.handle, int(c.properties)] for c in service.characteristics}
            for service in peer.services
        }

    def characteristic(self, order):
        found = self.peers[self.board(order)].get_characteristics_by_uuid(core.UUID(order["uuid"]))
        if not found:
            raise core.InvalidStateError("not discovered")
        return found[0]

    async def do_subscribe(self, order):
        number = self.board(order)
        characteristic = self.characteristic(order)
        await self.peers[number].discover_descriptors(characteristic)
        await self.peers[number].subscribe(
            characteristic, lambda value: note(board=number, notified=bytes(value).hex())
        )

    async def do_unsubscribe(self, order):
        await self.peers[self.board(order)].unsubscribe(self.characteristic(order))

    async def do_read(self, order):
        value = await self.peers[self.board(order)].read_value(self.characteristic(order))
        return bytes(value).hex()

    async def do_write(self, order):
        pieces = order["bytes"] if isinstance(order["bytes"], list) else [order["bytes"]]
        for piece in pieces:
            await self.peers[self.board(order)].write_value(
                self.characteristic(order), bytes.fromhex(piece), with_response=order.get("response", False)
            )


def forget(board):
    """A reset: the board knows nothing of a connection, and the laptop does not hear of it yet."""
    addresses = [connection.self_address for connection in board.le_connections.values()]
    board.le_connections.clear()
    board.le_legacy_advertiser.stop()
    for advertising_set in board.advertising_sets.values():
        advertising_set.stop()
    board.advertising_sets.clear()
    return addresses


def drop(link, board, addresses):
    """Silence has lasted for the supervision timeout: whoever is still connected to these addresses is not any more."""
    for controller in list(link.controllers):
        if controller is not board:
            for connection in list(controller.le_connections.values()):
                if connection.peer_address in addresses:
                    controller.on_le_disconnected(connection, TIMEOUT)


def lost(link, board):
    connections = list(board.le_connections.values())
    addresses = [connection.self_address for connection in connections]
    for connection in connections:
        board.on_le_disconnected(connection, TIMEOUT)
    drop(link, board, addresses)


def read(length):
    data = sys.stdin.buffer.read(length)
    if len(data) < length:
        sys.exit(0)
    return data


def main():
    random.seed(1)
    # Tests say what matters; a board that notifies before the laptop listens, and packets that nobody asked for, do not.
    logging.getLogger().setLevel(logging.CRITICAL)
    loop = VirtualLoop()
    asyncio.set_event_loop(loop)
    link, desk = None, None

    async def begin():
        nonlocal link, desk
        link = LocalLink()
        boards.extend(Board(number, link) for number in range(2))
        desk = Desk(link)
        await desk.start()

    task = loop.create_task(begin())
    loop.settle()
    task.result()
    while True:
        what, number = read(1)[0], read(1)[0]
        now, length = struct.unpack("<QI", read(12))
        content = read(length)
        loop.now = max(loop.now, now / HZ)
        board = boards[number]
        match what:
            case 0 if content:
                loop.call_soon(board.from_board, content)
            case 1:
                loop.call_soon(lost, link, board)
            case 2:
                addresses = forget(board)
                (silence,) = struct.unpack("<Q", content)
                if addresses:
                    loop.call_later(silence / HZ, drop, link, board, addresses)
            case 3:
                order = json.loads(content)
                loop.call_soon(desk.order, order)
        loop.settle()
        timer = loop.next_timer()
        due = NEVER if timer is None else max(int(timer * HZ) + 1, now + 1)
        out = [struct.pack("<QI", due, len(answer))]
        for who, data in answer:
            out.append(struct.pack("<BI", who, len(data)) + data)
        answer.clear()
        sys.stdout.buffer.write(b"".join(out))
        sys.stdout.buffer.flush()


main()
