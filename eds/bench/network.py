"""Parameters of the network: bit rate, cycle, supervision times, turnarounds.

All wire settings that a user may change are declared here, and nowhere else.
"""

from dataclasses import dataclass

from eds.declaration import DeclaredBench, packaged
from parameters import apart, parameter


@dataclass(frozen=True)
class Monitor:
    """The safety monitor on the bench, `[monitor]` of the configuration."""

    file: str = parameter("", "", 'file with the bounds of one person; "packaged": those for 40 N; empty: no monitor',
                          source="docs/safety.md")


@dataclass(frozen=True)
class Network:
    """The network's parameters, `[network]` of the configuration."""

    bitrate: int = parameter(1_000_000, "bit/s", "bit rate of the bus: 125000, 250000, 500000, 800000 or 1000000",
                             low=125_000, high=1_000_000, source="CiA 301, table 1")
    rate_hz: int = parameter(1000, "Hz", "control cycles, and SYNC frames, per second", low=10, high=2000,
                             source="assumed: rate of the drives' position loop")
    heartbeat_ms: int = parameter(100, "ms", "heartbeat period of every node and the master", low=10, high=10_000,
                                  source="assumed: CiA 301, 7.2.8.2.2.3")
    heartbeat_timeout_ms: int = parameter(250, "ms", "time without a heartbeat after which a node counts as lost",
                                          low=20, high=30_000, source="assumed: two and a half heartbeats")
    emcy_inhibit_ms: int = parameter(100, "ms", "least time between two EMCY frames of one node", low=1, high=6000,
                                     source="assumed: CiA 301, 7.5.2.18")
    start_deadline_cycles: int = parameter(5, "", "cycles without START's tension after which the servo reacts", low=2,
                                           high=100, source="assumed: 0x1402:05")
    targets_deadline_ms: int = parameter(100, "ms", "time without targets after which a drive reacts; 0: never", low=0,
                                         high=10_000, source="assumed: 0x1400:05")
    sampling_us: int = parameter(500, "µs", "sampling interval of the tension sensors", low=209, high=100_000,
                                 source="assumed: the AD7192 converts at up to 4.8 kHz; 0x6114")
    node_turnaround_us: int = parameter(10, "µs", "time a node takes from a frame to its answer, at worst", low=0,
                                        high=10_000, source="assumed: a 100 MHz microcontroller")
    compute_budget_us: int = parameter(100, "µs", "time the master may take from the last input to its targets", low=1,
                                       high=100_000, source="assumed: controller step and socket calls")

    bench: DeclaredBench = apart(packaged())  # noqa: RUF009 - read once, frozen
    """Devices, joints and force paths, which the configuration holds as `[[device]]`, `[[joint]]`, `[[force_path]]`."""
    monitor: str = apart("")
    """File with the bounds of the safety monitor on this network, `[monitor]`; empty: there is none."""

    @property
    def period_us(self) -> int:
        """Control period, µs."""
        return 1_000_000 // self.rate_hz

    @property
    def start_deadline_ms(self) -> int:
        """0x1402:05 of the servo, ms, at least 2."""
        return max(2, -(-self.start_deadline_cycles * self.period_us // 1000))
