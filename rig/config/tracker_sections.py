"""Sections of the rig file about trackers: the keys of every driver, and those of each driver of softrig."""

from __future__ import annotations

import ipaddress
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import AfterValidator, Field, model_validator
from pydantic.json_schema import SkipJsonSchema

from protocols.validation import ValidationFault, faults
from rig.config.drivers import DeviceSection, Driver, DriverRegistry
from rig.config.sections import Placement
from rig.sections.quantities import NonNegative, Number, Positive


def _address(text: str) -> str:
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError:
        raise ValueError("an IPv4 address, such as 127.0.0.1") from None


Address = Annotated[str, AfterValidator(_address)]
Port = Annotated[int, Field(ge=1, le=65535, strict=True)]
Milliseconds = Annotated[float, Field(ge=0, le=10_000, allow_inf_nan=False, strict=True)]


class TrackerConfig(DeviceSection):
    """A device that gives the pose of a body on the end cap. A driver adds keys of its own in a subclass.

    `placement` is the tracker's frame in the rod-base frame, `body` the body's frame in the tip frame.
    """

    rate_hz: Number = Field(default=100.0, ge=1, le=1000, description="poses per second that the tracker sends")
    placement: Placement = Placement()
    body: Placement = Placement()
    delay_ms: Milliseconds = Field(
        default=0.0, description="constant part of the delay from the pose to its arrival; one-way messages hide it"
    )
    delay_std_ms: Milliseconds = Field(default=0.0, description="standard uncertainty of delay_ms")
    largest_drift_ppm: Positive = Field(default=200.0, le=10_000, description="the sender's clock drifts by less")
    latest_ms: Positive = Field(default=200.0, description="a message that arrives later after its pose is not used")
    reach_mm: Positive | SkipJsonSchema[None] = Field(
        default=None, description="a tip farther from the rod base is no pose; default: three lengths of the arm"
    )


class UdpTrackerConfig(TrackerConfig):
    """A tracker that sends softrig's datagram (docs/reference/tracker-datagram.md)."""

    driver: Literal["udp"]
    address: Address = Field(default="127.0.0.1", description="own address to listen at; others are not listened to")
    port: Port
    sender: Address = Field(default="127.0.0.1", description="messages of other senders are not used")
    sender_port: Port | SkipJsonSchema[None] = Field(default=None, description="the sender's port; default: any")


class MockTrackerConfig(TrackerConfig):
    """A tracker of the simulated bench, whose sender has a clock of its own."""

    driver: Literal["mock"]
    noise_mm: NonNegative = Field(default=0.1, description="standard deviation of the position, per axis")
    noise_deg: NonNegative = Field(default=0.1, description="standard deviation of the orientation, per axis")
    true_delay_ms: Milliseconds = Field(default=2.0, description="true constant part of the delay")
    jitter_ms: Milliseconds = Field(default=1.0, description="mean of the exponential part of the delay")
    drift_ppm: Number = Field(default=50.0, ge=-10_000, le=10_000, description="true drift of the sender's clock")
    step_ms: Number = Field(default=0.0, ge=-10_000, le=10_000, description="the sender's clock is set by this, once")
    step_s: NonNegative = Field(default=0.0, description="time of that step after the first message")
    lost: NonNegative = Field(default=0.0, lt=1, description="share of lost messages")
    doubled: NonNegative = Field(default=0.0, lt=1, description="share sent twice")

    @model_validator(mode="after")
    def _noise_is_stated(self) -> MockTrackerConfig:
        if self.noise_mm == 0 or self.noise_deg == 0:
            key = "noise_mm" if self.noise_mm == 0 else "noise_deg"
            faults([ValidationFault((key,), "more than 0: a measured pose has an uncertainty")])
        return self


TRACKER_DRIVERS = DriverRegistry(
    "trackers",
    TrackerConfig,
    {
        "udp": Driver(
            UdpTrackerConfig,
            "rig.hardware.trackers.udp:UdpTracker",
            "poses in UDP datagrams from another program",
            examine="rig.hardware.trackers.udp:examine",
        ),
        "mock": Driver(
            MockTrackerConfig,
            "rig.simulator.mock_tracker:open_mock_tracker",
            "a tracker of the simulated bench",
            simulated=True,
        ),
    },
)

if TYPE_CHECKING:
    AnyTracker = TrackerConfig
else:
    AnyTracker = TRACKER_DRIVERS.section()
    """A tracker of the rig file, by the model of its driver."""
