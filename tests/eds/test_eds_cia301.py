"""CiA 301's tables hang together."""

from eds import cia301
from eds.cia301 import NMT_TRANSITIONS, SERVICES, Abort, Emcy, NmtCommand, NmtState, Service
from eds.emcy_codes import emcy_text


def test_every_command_leads_somewhere_from_every_state_that_hears_it():
    hearing = [state for state, services in SERVICES.items() if Service.NMT in services]
    assert set(NMT_TRANSITIONS) == {(state, command) for state in hearing for command in NmtCommand}


def test_states_gate_services():
    assert Service.PDO in SERVICES[NmtState.OPERATIONAL]
    assert Service.PDO not in SERVICES[NmtState.PRE_OPERATIONAL]
    assert Service.SDO not in SERVICES[NmtState.STOPPED]
    assert Service.ERROR_CONTROL in SERVICES[NmtState.STOPPED]


def test_transmission_types_allowed():
    allowed = [kind for kind in range(256) if cia301.pdo_type_allowed(kind)]
    assert allowed == [*range(241), 254, 255]


def test_any_emcy_code_has_words():
    assert emcy_text(0x8250) == "RPDO time-out"
    assert emcy_text(0x2340) == "short circuit, motor side"
    assert emcy_text(0xB000) == "reserved error code"
    assert all(emcy_text(code) for code in range(0, 0x10000, 0x80))


def test_codes_are_what_they_say():
    assert Abort(0x06090030) is Abort.INVALID_VALUE
    assert Emcy(0x8250) is Emcy.RPDO_TIMEOUT
    assert len({code.text for code in Abort}) == len(Abort)
    assert all(code.register & 1 for code in Emcy if code)
    assert cia301.SIGNATURE_SAVE.to_bytes(4, "little") == b"save"
    assert cia301.SIGNATURE_LOAD.to_bytes(4, "little") == b"load"
    assert cia301.SIGNATURE_ZERO.to_bytes(4, "little") == b"zero"
