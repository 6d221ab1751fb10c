"""EMCY error codes in words: CiA 301 table 26, CiA 402 (IEC 61800-7-201), CiA 404, and a manufacturer's own.

The rule of this file: tables only; a profile's table counts for devices of that profile, a manufacturer's for its EDS.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from eds.cia301 import Emcy

DRIVES, MEASURING = 402, 404


def _table(text: str) -> dict[int, str]:
    return {int(line[:4], 16): line[5:] for line in text.strip().splitlines()}


_GENERAL: Final = MappingProxyType(_table("""
0000 error reset or no error
1000 generic error
2000 current
2100 current, device input side
2200 current inside the device
2300 current, device output side
3000 voltage
3100 mains voltage
3200 voltage inside the device
3300 output voltage
4000 temperature
4100 ambient temperature
4200 device temperature
5000 device hardware
6000 device software
6100 internal software
6200 user software
6300 data set
7000 additional modules
8000 monitoring
8100 communication
8110 CAN overrun, objects lost
8120 CAN in error-passive mode
8130 life guard or heartbeat error
8140 recovered from bus-off
8150 CAN-ID collision
8200 protocol error
8210 PDO not processed due to length error
8220 PDO length exceeded
8230 DAM MPDO not processed, destination object not available
8240 unexpected SYNC data length
8250 RPDO time-out
9000 external error
F000 additional functions
FF00 device-specific
"""))
"""CiA 301, table 26."""

_DRIVES: Final = MappingProxyType(_table("""
2110 short circuit or earth leakage, input
2120 earth leakage, input
2121 earth leakage, phase L1
2122 earth leakage, phase L2
2123 earth leakage, phase L3
2130 short circuit, input
2131 short circuit, phases L1-L2
2132 short circuit, phases L2-L3
2133 short circuit, phases L3-L1
2211 internal current no. 1
2212 internal current no. 2
2213 over-current in ramp function
2214 over-current in the sequence
2220 continuous over-current inside the device
2221 continuous over-current inside the device no. 1
2222 continuous over-current inside the device no. 2
2230 short circuit or earth leakage inside the device
2240 earth leakage inside the device
2250 short circuit inside the device
2310 continuous over-current at the device output
2311 continuous over-current at the device output no. 1
2312 continuous over-current at the device output no. 2
2320 short circuit or earth leakage, motor side
2330 earth leakage, motor side
2331 earth leakage, phase U
2332 earth leakage, phase V
2333 earth leakage, phase W
2340 short circuit, motor side
2341 short circuit, phases U-V
2342 short circuit, phases V-W
2343 short circuit, phases W-U
2350 load level (I²t, thermal state)
2351 load level warning (I²t, thermal state)
3110 mains over-voltage
3111 mains over-voltage, phase L1
3112 mains over-voltage, phase L2
3113 mains over-voltage, phase L3
3120 mains under-voltage
3121 mains under-voltage, phase L1
3122 mains under-voltage, phase L2
3123 mains under-voltage, phase L3
3130 phase failure
3131 phase failure L1
3132 phase failure L2
3133 phase failure L3
3134 phase sequence
3140 mains frequency
3141 mains frequency too high
3142 mains frequency too low
3210 DC link over-voltage
3211 DC link over-voltage no. 1
3212 DC link over-voltage no. 2
3220 DC link under-voltage
3221 DC link under-voltage no. 1
3222 DC link under-voltage no. 2
3230 load error
3310 output over-voltage
3311 output over-voltage, phase U
3312 output over-voltage, phase V
3313 output over-voltage, phase W
3320 armature circuit
3321 armature circuit interrupted
3330 field circuit
3331 field circuit interrupted
4110 excess ambient temperature
4120 ambient temperature too low
4130 temperature of the supply air
4140 temperature of the air outlet
4210 excess device temperature
4220 device temperature too low
4300 temperature of the drive
4310 excess temperature of the drive
4320 temperature of the drive too low
4400 temperature of the supply
4410 excess temperature of the supply
4420 temperature of the supply too low
5100 supply
5110 low supply voltage
5111 supply U1, ±15 V
5112 supply U2, +24 V
5113 supply U3, +5 V
5120 supply of the intermediate circuit
5200 control hardware
5210 measurement circuit
5220 computing circuit
5300 operating unit
5400 power section
5410 output stages
5420 chopper
5430 input stages
5440 contacts
5441 contact 1
5442 contact 2
5443 contact 3
5444 contact 4
5445 contact 5
5450 fuses
5451 fuse S1, L1
5452 fuse S2, L2
5453 fuse S3, L3
5500 data storage
5510 working memory
5520 program memory
5530 non-volatile memory
6010 software reset (watchdog)
6310 loss of parameters
6320 parameter error
7100 power modules
7110 brake chopper
7111 brake chopper failure
7112 over-current of the brake chopper
7113 protective circuit of the brake chopper
7120 motor
7121 motor blocked
7122 motor error or commutation malfunction
7123 motor tilted
7200 measurement circuit
7300 sensor
7301 tachometer fault
7302 tachometer of wrong polarity
7303 resolver 1 fault
7304 resolver 2 fault
7305 incremental sensor 1 fault
7306 incremental sensor 2 fault
7307 incremental sensor 3 fault
7310 speed sensor
7320 position sensor
7400 computation circuit
7500 communication module
7510 serial interface no. 1
7520 serial interface no. 2
7600 external data storage
8300 torque control
8311 excess torque
8312 difficult start-up
8313 standstill torque
8321 insufficient torque
8331 torque fault
8400 velocity control
8500 position control
8600 positioning
8611 following error
8612 reference limit
8613 homing error
8700 synchronisation control
8800 winding control
8900 process data monitoring
8A00 control
F001 deceleration
F002 sub-synchronous run
F003 stroke operation
F004 control function
"""))
"""CiA 402 (IEC 61800-7-201), error codes of 0x603F and EMCY."""

_MEASURING: Final = MappingProxyType(_table("""
5030 sensor fault: broken wire
F001 process value outside the sensor's span
"""))
"""CiA 404-1: the codes that this project's sensors send."""

_PROFILES: Final = MappingProxyType({DRIVES: _DRIVES, MEASURING: _MEASURING})


def emcy_text(code: int, profile: int | None = None, own: Mapping[int, str] = MappingProxyType({})) -> str:
    """Return an EMCY error code in words.

    `own` is the table of the device's EDS, `profile` the low word of its 0x1000; without a profile the codes of this
    bench's devices count first. A code that no table has gets the words of its sub-class, else of its class.
    """
    if code in own:
        return own[code]
    if profile is None:
        bench = next((emcy for emcy in Emcy if emcy == code), None)
        if bench is not None:
            return bench.text
    if code >> 8 == 0xFF:
        return _GENERAL[0xFF00]
    special = _PROFILES.get(profile, {}) if profile is not None else {**_DRIVES, 0xF001: _GENERAL[0xF000]}
    for mask in (0xFFFF, 0xFFF0, 0xFF00, 0xF000):
        found = special.get(code & mask) or _GENERAL.get(code & mask)
        if found is not None and (code & mask or not code):
            return found
    return "reserved error code"
