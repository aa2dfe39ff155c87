"""Which optional part of SkyRelay brings which package: what `pip install 'skyrelay[NAME]'` adds to the core.

The core plays, audits and explains a run. Everything else imports its packages where it needs them, and whoever meets a
package that is not there says by this table what to install.
"""

from __future__ import annotations

from skyrelay.core.errors import UsageError

EXTRAS = {
    "benchmarl": "peers",
    "equinox": "train",
    "gymnasium": "train",
    "jax": "train",
    "jaxtyping": "train",
    "libsumo": "sumo",
    "mavsdk": "pilot",
    "optax": "train",
    "pettingzoo": "train",
    "prometheus_client": "pilot",
    "ray": "ray",
    "tensorboardX": "tensorboard",
    "torchrl": "peers",
    "websockets": "pilot",
    "zenoh": "pilot",
}
"""From the name that is imported to the extra of pyproject.toml that brings it."""


def missing(module: str, error: ImportError) -> UsageError | None:
    """What to tell whoever lacks an extra; None for a module that no extra brings."""
    module = module.partition(".")[0]
    extra = EXTRAS.get(module)
    if extra is None:
        return None
    return UsageError(f"the package {module}", None, f"it to be there: pip install 'skyrelay[{extra}]' ({error})")
