"""Foreign CANopen nodes on the virtual wire: python canopen's local node, and npm's canopen in a process of its own."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import canopen

from bowden.testing import CanBus
from eds import packaged
from eds.cia301 import Frame
from virtual_bus.kernel import TIMER
from virtual_bus.wire.station import Station

ROOT = Path(__file__).resolve().parents[2]
MODULES = Path(os.environ.get("BOWDEN_NODE_MODULES", ROOT / "build" / "foreign" / "node_modules"))
EDS = str(packaged("knee_drive"))
MS = 1_000_000


class CanopenLocalNode(Station):
    """python canopen's `LocalNode` on the virtual wire, without a thread: it answers in the call that delivers."""

    def __init__(self, bus: CanBus, node_id: int) -> None:
        super().__init__(f"canopen {node_id}", self.heard)
        self._bus = bus
        self.network = canopen.Network(self)
        self.node = self.network.create_node(node_id, EDS)
        bus.wire.attach(self)
        self.node.nmt.state = "INITIALISING"
        self.node.nmt.state = "PRE-OPERATIONAL"

    def heard(self, frame: Frame, now_ns: int) -> None:
        self.network.notify(frame.can_id, bytearray(frame.data), now_ns / 1e9)

    def send(self, message: Any) -> None:
        self.submit(Frame(message.arbitration_id, bytes(message.data)), self._bus.now_ns)

    def send_periodic(self, message: Any, period: float) -> PeriodicFrame:
        return PeriodicFrame(self, message, period, self._bus)


class PeriodicFrame:
    """A frame that is sent in bus time until it is stopped, as python-can's `send_periodic` does."""

    def __init__(self, node: CanopenLocalNode, message: Any, period: float, bus: CanBus) -> None:
        self._node, self._message, self._period, self._bus = node, message, period, bus
        self._on = True
        self._beat()

    def _beat(self) -> None:
        if self._on:
            self._node.send(self._message)
            self._bus.after(self._period, self._beat)

    def modify_data(self, message: Any) -> None:
        self._message = message

    def stop(self) -> None:
        self._on = False


def npm_absent() -> str:
    """Say what of npm's canopen is missing; empty where it is there."""
    if shutil.which("node") is None:
        return "node is absent"
    return "" if (MODULES / "canopen").is_dir() else "npm's canopen is absent; .ci/nightly installs it in build/foreign"


class NpmNode(Station):
    """npm's `canopen` on the virtual wire, its timers in bus time: a device behind an EDS, or a master without one."""

    def __init__(self, bus: CanBus, node_id: int, eds: str | None = EDS) -> None:
        super().__init__(f"npm {node_id}", self.heard)
        self._bus = bus
        self._process = subprocess.Popen(
            ["node", str(Path(__file__).with_name("canopen_virtual.js")), str(node_id), *([eds] if eds else [])],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env={**os.environ, "NODE_PATH": str(MODULES)})
        self.done: list[dict[str, Any]] = []
        bus.wire.attach(self)
        self._turn()

    def heard(self, frame: Frame, now_ns: int) -> None:
        self._turn(frame=[frame.can_id, frame.data.hex()])

    def call(self, program: str, seconds: float = 20.0) -> Any:
        """Run an async function body with `device` and `canopen`; bus time passes until it ends."""
        self._turn(call=program)
        for _ in range(round(seconds * 1000)):
            if self.done:
                break
            self._bus.run(0.001)
        else:
            raise TimeoutError("no end")
        self._bus.run(0.001)
        ended = self.done.pop(0)
        if "error" in ended:
            raise RuntimeError(ended["error"])
        return ended.get("value")

    def close(self) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()

    def _turn(self, **told: Any) -> None:
        now_ns = self._bus.now_ns
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"now": now_ns / MS, **told}) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline())
        for can_id, data in answer["frames"]:
            self.submit(Frame(can_id, bytes.fromhex(data)), now_ns)
        self.done += answer["done"]
        if answer["due"] is not None:
            self._bus.kernel.at(max(now_ns, -int(-answer["due"] * MS // 1)), TIMER, self._turn)
