"""What a radio link carries: path loss, shadowing, interference, rate; for any array library.

Two laws of the air-to-ground link beside the paper's disc: the one of Al-Hourani et al. (free-space loss and an excess
by sight, whose probability goes by the angle of elevation), and the one of 3GPP TR 36.777 for aerial users.
Leading dimensions (``...``) are batches. Lengths are in metres, powers in dBm, losses in dB.

Sources:
    A. Al-Hourani, S. Kandeepan, S. Lardner, "Optimal LAP altitude for maximum coverage", IEEE Wireless Communications
    Letters 3(6), 2014 (Eq. 4 and 5; a, b and the excess losses at 2 GHz by environment).
    3GPP TR 36.777 V15.0.0, Annex B, Tables B-1 (sight), B-2 (path loss) and B-3 (shadowing).
    M. Gudmundson, "Correlation model for shadow fading in mobile radio systems", Electronics Letters 27(23), 1991.
    S. Jaeckel, L. Raschkowski, F. Burkhardt, L. Thiele, "Efficient sum-of-sinusoids-based spatial consistency for the
    3GPP new-radio channel model", IEEE Globecom Workshops, 2018.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from skyrelay.core.scenario import Radio

SPEED_OF_LIGHT = 299_792_458.0
THERMAL_NOISE = -174.0
"""Of a resistor at 290 K [dBm/Hz]."""


@dataclass(frozen=True)
class Environment:
    """What stands between a UAV and the ground (Al-Hourani et al.).

    Attributes:
        a, b: of the sigmoid of the probability of sight, the angle in degrees.
        sight, hidden: loss over that of free space, with a line of sight and without [dB].
    """

    a: float
    b: float
    sight: float
    hidden: float


ENVIRONMENTS = {
    "suburban": Environment(4.88, 0.43, 0.1, 21.0),
    "urban": Environment(9.61, 0.16, 1.0, 20.0),
    "dense-urban": Environment(12.08, 0.11, 1.6, 23.0),
    "high-rise": Environment(27.23, 0.08, 2.3, 34.0),
}


def free_space_loss(distance: Any, frequency: float) -> Any:
    """[...] the loss of Friis [dB] over a distance [m] at a frequency [Hz]; never below none at all."""
    xp = distance.__array_namespace__()
    return 20.0 * xp.log10(xp.maximum(4.0 * np.pi * distance * frequency / SPEED_OF_LIGHT, xp.ones_like(distance)))


def sight_probability(across: Any, altitude: float, environment: Environment) -> Any:
    """[...] that nothing stands in the way, by the angle of elevation (Al-Hourani et al., Eq. 5).

    Args:
        across: [...] horizontal distance [m].
        altitude: of the UAV over the vehicle [m].
    """
    xp = across.__array_namespace__()
    angle = xp.atan2(xp.full_like(across, altitude), across) * (180.0 / np.pi)
    return 1.0 / (1.0 + environment.a * xp.exp(-environment.b * (angle - environment.a)))


def air_to_ground_losses(across: Any, altitude: float, frequency: float, environment: Environment) -> tuple[Any, Any]:
    """[...] path loss [dB] with a line of sight and without: that of free space and an excess.

    Args: as in `sight_probability`; frequency [Hz].
    """
    xp = across.__array_namespace__()
    free = free_space_loss(xp.sqrt(across * across + altitude**2), frequency)
    return free + environment.sight, free + environment.hidden


def air_to_ground_loss(across: Any, altitude: float, frequency: float, environment: Environment) -> Any:
    """[...] the mean path loss [dB]: both of `air_to_ground_losses` by how likely each is. Arguments as there."""
    seen = sight_probability(across, altitude, environment)
    sight, hidden = air_to_ground_losses(across, altitude, frequency, environment)
    return sight * seen + hidden * (1.0 - seen)


Cell = Literal["UMa-AV", "UMi-AV"]
"""Cells of TR 36.777 with aerial users: urban macro, urban micro."""


def tr36777_sight_probability(across: Any, altitude: float, cell: Cell) -> Any:
    """[...] that nothing stands in the way (TR 36.777, Table B-1), for altitudes from 22.5 m to 300 m.

    Args:
        across: [...] horizontal distance [m].
        altitude: of the UAV over the ground [m].
    Raises:
        ValueError: the table has no such altitude.
    """
    xp = across.__array_namespace__()
    _within_tr36777(altitude)
    high = float(np.log10(altitude))
    if cell == "UMa-AV":
        if altitude > 100.0:
            return xp.ones_like(across)
        decay, edge = 4300.0 * high - 3800.0, max(460.0 * high - 700.0, 18.0)
    else:
        decay, edge = 233.98 * high - 0.95, max(294.05 * high - 432.94, 18.0)
    share = edge / xp.maximum(across, xp.full_like(across, edge))
    return share + xp.exp(-across / decay) * (1.0 - share)


def tr36777_losses(across: Any, altitude: float, frequency: float, cell: Cell, ground: float = 1.5) -> tuple[Any, Any]:
    """[...] path loss [dB] with a line of sight and without (TR 36.777, Table B-2).

    The report's own links are between a base station's mast and an aerial user; here the other end is a vehicle.

    Args:
        across, altitude: as in `tr36777_sight_probability`.
        frequency: [Hz].
        ground: height of the vehicle's antenna [m].
    Raises:
        ValueError: the table has no such altitude; without sight it is held to UMa-AV's 100 m.
    """
    xp = across.__array_namespace__()
    _within_tr36777(altitude)
    distance = xp.sqrt(across * across + (altitude - ground) ** 2)
    far, high, band = xp.log10(distance), float(np.log10(altitude)), 20.0 * float(np.log10(frequency / 1e9))
    if cell == "UMa-AV":
        sight = 28.0 + 22.0 * far + band
        lower = float(np.log10(min(altitude, 100.0)))
        hidden = -17.5 + (46.0 - 7.0 * lower) * far + 20.0 * float(np.log10(40.0 * np.pi * frequency / 3e9))
        return sight, xp.maximum(hidden, sight)
    sight = xp.maximum(free_space_loss(distance, frequency), 30.9 + (22.25 - 0.5 * high) * far + band)
    return sight, xp.maximum(sight, 32.4 + (43.2 - 7.6 * high) * far + band)


def tr36777_loss(across: Any, altitude: float, frequency: float, cell: Cell, ground: float = 1.5) -> Any:
    """[...] the mean path loss [dB]: both of `tr36777_losses` by how likely each is. Arguments and raises as there."""
    seen = tr36777_sight_probability(across, altitude, cell)
    sight, hidden = tr36777_losses(across, altitude, frequency, cell, ground)
    return sight * seen + hidden * (1.0 - seen)


def tr36777_shadowing(altitude: float, cell: Cell) -> tuple[float, float]:
    """Standard deviation of the shadowing [dB] with a line of sight and without (TR 36.777, Table B-3)."""
    _within_tr36777(altitude)
    if cell == "UMa-AV":
        return 4.64 * float(np.exp(-0.0066 * altitude)), 6.0
    return max(5.0 * float(np.exp(-0.01 * altitude)), 2.0), 8.0


def _within_tr36777(altitude: float) -> None:
    if not 22.5 < altitude <= 300.0:
        raise ValueError(f"TR 36.777 has UAVs above 22.5 m and up to 300 m, not at {altitude:g} m")


WAVES = 128
"""Of which a field of shadowing is made."""


@dataclass(frozen=True)
class Shadowing:
    """Correlated log-normal shadowing as a function of where both ends of a link are: nothing has to be remembered.

    A sum of cosines over the place of both ends (Jaeckel et al.), whose waves are drawn from the spectrum of an
    exponential correlation: in the plane a Cauchy distribution. Two links whose ends are a way of d apart (both ends'
    ways summed) correlate by exp(-d / correlation), as in Gudmundson's model.

    Attributes:
        ground, air: [WAVES, 2] waves over the place of either end [rad/m].
        phase: [WAVES] [rad].
    """

    ground: Any
    air: Any
    phase: Any

    @classmethod
    def drawn(cls, seed: int, correlation: float) -> Shadowing:
        """A field of standard deviation 1; correlation distance in metres."""
        random = np.random.default_rng([seed, 5])
        normal, scale = random.standard_normal((2, WAVES, 2)), np.abs(random.standard_normal((2, WAVES, 1)))
        ground, air = normal / (scale * correlation)
        return cls(ground, air, random.uniform(0.0, 2.0 * np.pi, WAVES))

    def between(self, uavs: Any, vehicles: Any) -> Any:
        """[..., N, V] of UAVs [..., N, 2] and vehicles [..., V, 2]."""
        xp = uavs.__array_namespace__()
        ground, air, phase = (xp.asarray(part, dtype=uavs.dtype) for part in (self.ground, self.air, self.phase))
        # cos(a + b) in two products, so that the cost of a link is one row times one column.
        up, down = uavs @ air.T, vehicles @ ground.T + phase
        turned = xp.matrix_transpose(xp.concat([xp.cos(down), -xp.sin(down)], axis=-1))
        return float(np.sqrt(2.0 / WAVES)) * (xp.concat([xp.cos(up), xp.sin(up)], axis=-1) @ turned)


def noise(bandwidth: float, figure: float) -> float:
    """A receiver's noise [dBm] over a bandwidth [Hz], by its noise figure [dB]."""
    return THERMAL_NOISE + 10.0 * float(np.log10(bandwidth)) + figure


def sinr(received: Any, owner: Any, channel: Any, sending: Any, floor: float) -> Any:
    """[..., V] each vehicle's own signal over noise and the other UAVs on its channel, as a ratio; 0 without a UAV.

    Args:
        received: [..., N, V] power from each UAV at each vehicle [dBm].
        owner: [..., V] row of the vehicle's UAV; negative for none.
        channel: [..., N] number of the channel that each UAV sends on.
        sending: [..., N] false for a UAV that is silent: it neither serves nor disturbs.
        floor: noise [dBm].
    """
    xp = received.__array_namespace__()
    power = xp.where(sending[..., :, None], 10.0 ** (received / 10.0), 0.0)
    own = owner[..., None, :] == xp.arange(received.shape[-2])[:, None]
    signal = xp.sum(xp.where(own, power, 0.0), axis=-2)
    served_on = xp.take_along_axis(channel, xp.maximum(owner, xp.asarray(0)), axis=-1)
    same = channel[..., :, None] == served_on[..., None, :]
    # Others are summed by themselves: what is left of a sum of all would be rounding where one's own is strongest.
    others = xp.sum(xp.where(same & ~own, power, 0.0), axis=-2)
    return signal / (others + 10.0 ** (floor / 10.0))


def spectral_efficiency(ratio: Any, cap: float, least: float = 0.0) -> Any:
    """[...] what a hertz carries [bit/s/Hz] at a SINR: Shannon's bound, no more than the best modulation and code.

    Args:
        ratio: [...] SINR, not in dB.
        cap: of the best modulation and code [bit/s/Hz].
        least: SINR, not in dB, below which a link carries nothing.
    """
    xp = ratio.__array_namespace__()
    bound = xp.minimum(xp.log2(1.0 + ratio), xp.full_like(ratio, cap))
    return xp.where(ratio >= least, bound, 0.0)


def link_capacity(distance: Any, power: float, frequency: float, bandwidth: float, floor: float, cap: float) -> Any:
    """[...] what a link in free space carries over a distance [m], on a channel of its own [kbit/s].

    UAVs fly at one altitude, above the roofs; a gateway's antenna is above them as well.

    Args:
        power: sent, with both antennas' gains [dBm].
        frequency, bandwidth: of the link [Hz].
        floor: noise [dBm].
        cap: as in `spectral_efficiency`.
    """
    loss = free_space_loss(distance, frequency)
    return spectral_efficiency(10.0 ** ((power - loss - floor) / 10.0), cap) * (bandwidth / 1000.0)


@dataclass(frozen=True)
class Air:
    """A scenario's radio at its fleet's altitude, for any array library.

    Attributes:
        radio: its numbers; its model is no disc.
        altitude: of the UAVs [m].
        field: of the shadowing; None where it has none.
    """

    radio: Radio
    altitude: float
    field: Shadowing | None

    def losses(self, across: Any) -> tuple[Any, Any, Any]:
        """[...] probability of sight, path loss [dB] with a line of sight and without, over a distance across [m]."""
        radio, frequency = self.radio, self.radio.carrier * 1e9
        if radio.model == "tr36777":
            seen = tr36777_sight_probability(across, self.altitude, radio.cell)
            return seen, *tr36777_losses(across, self.altitude, frequency, radio.cell, radio.antenna)
        height, environment = self.altitude - radio.antenna, ENVIRONMENTS[radio.environment]
        seen = sight_probability(across, height, environment)
        return seen, *air_to_ground_losses(across, height, frequency, environment)

    def deviations(self) -> tuple[float, float]:
        """Standard deviation of the shadowing [dB] with a line of sight and without."""
        if self.radio.shadowing is not None:
            return self.radio.shadowing, self.radio.shadowing
        return tr36777_shadowing(self.altitude, self.radio.cell) if self.radio.model == "tr36777" else (0.0, 0.0)

    def received(self, uavs: Any, vehicles: Any, own: Any = None, seen: Any = None) -> Any:
        """[..., N, V] power of each UAV at each vehicle [dBm].

        Args:
            uavs, vehicles: [..., N, 2], [..., V, 2] [m].
            own: [..., N, V] the links whose line of sight is known; None: no link's is, and the mean counts.
            seen: [..., V] whether there is one.
        """
        xp = uavs.__array_namespace__()
        apart = uavs[..., :, None, :] - vehicles[..., None, :, :]
        likely, sight, hidden = self.losses(xp.sqrt(xp.sum(apart * apart, axis=-1)))
        if seen is not None:
            likely = xp.where(own, xp.astype(seen, likely.dtype)[..., None, :], likely)
        loss = sight * likely + hidden * (1.0 - likely)
        if self.field is not None:
            clear, blocked = self.deviations()
            loss = loss + self.field.between(uavs, vehicles) * (clear * likely + blocked * (1.0 - likely))
        return self.radio.power - loss

    def efficiency(
        self, uavs: Any, vehicles: Any, owner: Any, channel: Any, seen: Any = None, sending: Any = None
    ) -> Any:
        """[..., V] what a hertz carries from each vehicle's UAV to it [bit/s/Hz], the others on its channel disturbing.

        Args:
            uavs, vehicles: as in `received`.
            owner: [..., V] row of the vehicle's UAV; negative for none.
            channel: [..., N] of each UAV.
            seen: [..., V] whether nothing stands between the two; None: not known.
            sending: [..., N] false for a UAV that is silent; None where all send.
        """
        xp = uavs.__array_namespace__()
        own = owner[..., None, :] == xp.arange(uavs.shape[-2])[:, None]
        on = xp.ones(uavs.shape[:-1], dtype=xp.bool) if sending is None else sending
        return self.of_received(self.received(uavs, vehicles, own, seen), owner, channel, on)

    def of_received(self, received: Any, owner: Any, channel: Any, sending: Any) -> Any:
        """[..., V] the same from the powers of `received`."""
        ratio = sinr(received, owner, channel, sending, noise(self.radio.bandwidth * 1e6, self.radio.noise_figure))
        return spectral_efficiency(ratio, self.radio.efficiency, 10.0 ** (self.radio.least_sinr / 10.0))

    def backhaul(self, across: Any, height: float | None) -> Any:
        """[...] what a link between UAVs (None), or from one to a gateway of a height [m], carries [kbit/s]."""
        xp, radio = across.__array_namespace__(), self.radio
        distance = across if height is None else xp.sqrt(across * across + (self.altitude - height) ** 2)
        floor = noise(radio.link_bandwidth * 1e6, radio.noise_figure)
        hertz, frequency = radio.link_bandwidth * 1e6, radio.link_carrier * 1e9
        return link_capacity(distance, radio.link_power, frequency, hertz, floor, radio.efficiency)


def air(radio: Radio, altitude: float, seed: int) -> Air | None:
    """A scenario's; None for the paper's disc. The seed draws the shadowing."""
    if radio.model == "disc":
        return None
    law = Air(radio, altitude, None)
    if max(law.deviations()) == 0.0:
        return law
    return Air(radio, altitude, Shadowing.drawn(seed, radio.correlation))
