"""SkyRelay: UAV relays for connected vehicles, selected in the open and flown by learned policies.

    import skyrelay as sr

    run = sr.run("bologna", out="runs/first", policy="cover")
    run.vehicles.to_pandas()

What stands in `__all__` is the public interface (docs/reference/python.md); everything deeper may move. Each name is
imported when it is first used, so that nobody waits for what is not needed.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skyrelay.airspace.sight import Sight as Sight
    from skyrelay.api import RunFolder as RunFolder
    from skyrelay.api import compare as compare
    from skyrelay.api import evaluate as evaluate
    from skyrelay.api import load_run as load_run
    from skyrelay.api import make as make
    from skyrelay.api import make_vec as make_vec
    from skyrelay.api import policies as policies
    from skyrelay.api import run as run
    from skyrelay.core.entities import UavTable as UavTable
    from skyrelay.core.entities import VehicleTable as VehicleTable
    from skyrelay.core.errors import SkyRelayError as SkyRelayError
    from skyrelay.core.scenario import Scenario as Scenario
    from skyrelay.core.scenario import load_scenario as load_scenario
    from skyrelay.policy import Policy as Policy
    from skyrelay.selection import Selection as Selection
    from skyrelay.selection import select as select

__version__ = "0.1.0"

_HOMES = {
    "Policy": "skyrelay.policy",
    "RunFolder": "skyrelay.api",
    "Scenario": "skyrelay.core.scenario",
    "Selection": "skyrelay.selection",
    "Sight": "skyrelay.airspace.sight",
    "SkyRelayError": "skyrelay.core.errors",
    "UavTable": "skyrelay.core.entities",
    "VehicleTable": "skyrelay.core.entities",
    "compare": "skyrelay.api",
    "evaluate": "skyrelay.api",
    "load_run": "skyrelay.api",
    "load_scenario": "skyrelay.core.scenario",
    "make": "skyrelay.api",
    "make_vec": "skyrelay.api",
    "policies": "skyrelay.api",
    "run": "skyrelay.api",
    "select": "skyrelay.selection",
}
"""Where each public name is."""

__all__ = [
    "Policy",
    "RunFolder",
    "Scenario",
    "Selection",
    "Sight",
    "SkyRelayError",
    "UavTable",
    "VehicleTable",
    "__version__",
    "compare",
    "evaluate",
    "load_run",
    "load_scenario",
    "make",
    "make_vec",
    "policies",
    "run",
    "select",
]


def __getattr__(name: str) -> Any:
    """A public name, when it is first used."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
