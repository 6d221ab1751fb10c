"""Parameters of a node as DCF: read, compared, restored, and checked at bring-up."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from eds import dictionary
from eds.bench.bench_network import SERVO, START, Network, WireLayout, wire
from eds.cia301 import NmtCommand
from eds.dictionary import key
from master.cycle.log import Log
from master.network import bringup
from master.network.link import Link
from master.node_access import dcf
from parameters import InputError

if TYPE_CHECKING:
    from conftest import Composer

GAIN, MOMENT = (0x60FB, 1), datetime(2030, 5, 17, 9, 30)


def backed_up(link: Link, described: WireLayout, node_id: int, path: Path) -> dictionary.Dictionary:
    link.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, 0)
    entry = described.nodes[node_id]
    values = {**dcf.backup(link, entry), **dcf.stamp(entry.dictionary, MOMENT)}
    path.write_text(dcf.as_dcf(entry.dictionary, node_id, values), encoding="utf-8")
    return dictionary.read(path)


@pytest.mark.parametrize("node_id", [SERVO, START])
def test_what_was_backed_up_is_what_the_node_holds(composer: Composer, tmp_path: Path, node_id: int) -> None:
    link, _ = composer.link()
    described = wire(Network())
    file = backed_up(link, described, node_id, tmp_path / "node.dcf")
    assert dcf.compare(link, described.nodes[node_id], file) == []
    given = [entry for entry in dcf.parameters(file) if entry.value is not None]
    assert len(given) > 20


def test_a_changed_parameter_is_named_and_restored(composer: Composer, tmp_path: Path) -> None:
    link, _ = composer.link()
    described = wire(Network())
    servo = described.nodes[SERVO]
    file = backed_up(link, described, SERVO, tmp_path / "servo.dcf")
    held = link.sdo_read(SERVO, *GAIN)
    link.sdo_write(SERVO, *GAIN, (int.from_bytes(held, "little") + 5).to_bytes(len(held), "little"))
    (found,) = dcf.compare(link, servo, file)
    assert (found.object, found.subindex) == GAIN
    assert dcf.restore(link, servo, file) == [found]
    assert link.sdo_read(SERVO, *GAIN) == held
    assert dcf.compare(link, servo, file) == []


def test_bring_up_wants_the_configuration_that_the_dcf_names(composer: Composer, tmp_path: Path) -> None:
    link, tap = composer.link()
    plain = wire(Network())
    file = backed_up(link, plain, SERVO, tmp_path / "servo.dcf")
    nodes = {**plain.nodes, SERVO: plain.nodes[SERVO]._replace(dictionary=file)}
    described = WireLayout(Network(), nodes)
    with pytest.raises(bringup.BringUpError, match=r"servo \(node 1\): configuration date \(0x1020\) is 0"):
        bringup.bring_up(link, described, Log(tap, None, 0x201))
    link.nmt(NmtCommand.ENTER_PRE_OPERATIONAL, 0)
    dcf.restore(link, nodes[SERVO], file)
    assert bringup.identify(link, nodes[SERVO]) == 0


def test_a_value_that_the_node_refuses_is_named(composer: Composer, tmp_path: Path) -> None:
    link, _ = composer.link()
    described = wire(Network())
    path = tmp_path / "start.dcf"
    backed_up(link, described, START, path)
    text = path.read_text().replace("[6114sub1]\nParameterValue=500", "[6114sub1]\nParameterValue=1")
    if text == path.read_text():
        text = text.replace("[6114sub1]\nParameterValue=", "[6114sub1]\nParameterValue=1 ;")
    path.write_text(text)
    with pytest.raises(InputError, match=r"start\.dcf: .* = 1 is refused \(node 3, object 0x6114:01"):
        dcf.restore(link, described.nodes[START], dictionary.read(path))


def test_the_date_is_counted_from_1984() -> None:
    stamp = dcf.stamp(wire(Network()).nodes[SERVO].dictionary, datetime(1984, 1, 3, 0, 0, 1))
    assert stamp == {key(0x1020, 1): 2, key(0x1020, 2): 1000}
