"""What a rotary-wing UAV's flight takes, by its speed; for any array library.

Source: Y. Zeng, J. Xu, R. Zhang, "Energy minimization for wireless communication with rotary-wing UAV", IEEE
Transactions on Wireless Communications 18(4), 2019, Eq. 12 with the parameters of its Table I.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from skyrelay.core.scenario import Energy


@dataclass(frozen=True)
class Rotor:
    """A UAV of 2 kg (Table I).

    Attributes:
        weight: [N].
        air: density [kg/m3].
        radius: of the rotor [m].
        area: of its disc [m2].
        spin: angular velocity of the blades [rad/s].
        solidity: blades' share of the disc's area.
        drag: of the blades' profile.
        induced: correction of the induced power.
        downwash: mean induced velocity in hover [m/s].
        fuselage: drag ratio of the fuselage.
    """

    weight: float = 20.0
    air: float = 1.225
    radius: float = 0.4
    area: float = 0.503
    spin: float = 300.0
    solidity: float = 0.05
    drag: float = 0.012
    induced: float = 0.1
    downwash: float = 4.03
    fuselage: float = 0.6

    def power(self, speed: Any) -> Any:
        """[...] what level flight at a speed [m/s] takes [W] (Eq. 12): the blades' profile, lift, and the fuselage.

        Acceleration is left out, as it is there.
        """
        xp = speed.__array_namespace__()
        tip = self.spin * self.radius
        profile = self.drag / 8.0 * self.air * self.solidity * self.area * tip**3
        lift = (1.0 + self.induced) * self.weight**1.5 / (2.0 * self.air * self.area) ** 0.5
        squared = speed * speed
        # The paper's sqrt(1 + x^2) - x, written so that it does not vanish in rounding at high speed.
        fast = squared / (2.0 * self.downwash**2)
        less = 1.0 / (xp.sqrt(1.0 + fast * fast) + fast)
        parasite = 0.5 * self.fuselage * self.air * self.solidity * self.area * squared * speed
        return profile * (1.0 + 3.0 * squared / tip**2) + lift * xp.sqrt(less) + parasite


def per_minute(power: Any, battery: float) -> Any:
    """[...] what a power [W] takes of a battery [Wh] in a minute [%]."""
    return power / (60.0 * battery) * 100.0


def rated(energy: Energy, speed: float, wind: float = 0.0) -> Energy:
    """A scenario's energy with what hovering in a wind and moving at an airspeed cost [m/s], by its model.

    Who hovers in a wind flies at its speed through the air.
    """
    if energy.model == "linear":
        return energy
    power = Rotor().power(np.array([wind, speed])) + energy.payload
    hover, move = per_minute(power, energy.battery).tolist()
    return energy.model_copy(update={"hover_per_minute": hover, "move_per_minute": move})
