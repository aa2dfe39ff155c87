"""What a host of agents is told by its file: who its members are, and where chain, store, bus and world are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from skyrelay.airspace.law import Law
from skyrelay.core.errors import UsageError
from skyrelay.core.resolved import ResolvedScenario, resolve
from skyrelay.core.scenario import load_scenario
from skyrelay.core.untrusted import parse_toml
from skyrelay.core.zones import ZoneGrid
from skyrelay.pilot.bus import ANY_PORT, Certificates, Weather

Name = Annotated[str, Field(min_length=1, max_length=80, pattern=r"^[\w.:-]+$")]
Address = Annotated[str, Field(pattern=r"^0x[0-9a-f]{40}$")]
Endpoint = Annotated[str, Field(pattern=r"^(tcp|tls|quic|unixsock-stream)/.+")]
MAX_BYTES = 4 << 20
"""A larger file is no configuration."""


class Table(BaseModel):
    """A frozen table of a file; an unknown key is an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Area(Table):
    """The grid of zones; as `ZoneGrid`."""

    x0: float
    y0: float
    side: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    columns: Annotated[int, Field(ge=1, le=1000)]
    rows: Annotated[int, Field(ge=1, le=1000)]

    def grid(self) -> ZoneGrid:
        """Of the zones."""
        return ZoneGrid(**dict(self))


class ChainAccess(Table):
    """The contract, and the keys that speak to it."""

    urls: Annotated[list[str], Field(min_length=1, max_length=20)] = Field(description="endpoints, the next in reserve")
    chain_id: Annotated[int, Field(ge=1)] = Field(description="that every endpoint must have")
    contract: Address
    keystore: str = Field(description="of this host's members, encrypted")
    confirmations: Annotated[int, Field(ge=0, le=1000)] = 0


class StoreAccess(Table):
    """Where policies come from: a Kubo node, or a folder."""

    url: str | None = None
    path: str | None = None

    @model_validator(mode="after")
    def _one(self) -> StoreAccess:
        if (self.url is None) == (self.path is None):
            raise ValueError("either url or path")
        return self


class Tls(Table):
    """Certificates for links that are encrypted, in PEM; relative paths start from the folder of the host's file."""

    authority: str = Field(description="that has signed the certificate of every host")
    certificate: str = Field(description="of this host, for the address at which others reach it")
    key: str = Field(description="of this host")


class BusAccess(Table):
    """Where this host is reached on the bus, and by whom it finds the others."""

    listen: list[Endpoint] = [ANY_PORT]
    connect: list[Endpoint] = []
    tls: Tls | None = None
    loss: Annotated[float, Field(ge=0, lt=1)] = Field(0.0, description="share of the beacons that are lost, for trials")
    delay: Annotated[float, Field(ge=0, le=60)] = Field(0.0, description="of the others, for trials [s]")
    seed: int = Field(0, description="of what is lost")

    @model_validator(mode="after")
    def _all_or_none(self) -> BusAccess:
        for endpoint in (*self.listen, *self.connect):
            if endpoint != ANY_PORT and endpoint.startswith("tls/") != (self.tls is not None):
                raise ValueError("tls = {...} and nothing but tls/ endpoints, or neither")
        return self

    def listens(self) -> list[str]:
        """Where this host is reached."""
        return [ANY_PORT.replace("tcp/", "tls/") if self.tls and e == ANY_PORT else e for e in self.listen]

    def certificates(self) -> Certificates | None:
        """What this host shows others."""
        if self.tls is None:
            return None
        return Certificates(Path(self.tls.authority), Path(self.tls.certificate), Path(self.tls.key))

    def placed(self, folder: Path) -> BusAccess:
        """With the files where they are, seen from a folder."""
        if self.tls is None:
            return self
        tls = {name: str(folder / path) for name, path in self.tls.model_dump().items()}
        return self.model_copy(update={"tls": Tls(**tls)})

    def weather(self) -> Weather:
        """What is put on this host's beacons."""
        return Weather(self.loss, self.delay, self.seed)


class Vehicle(Table):
    """A vehicle of this host."""

    name: Name
    demand: Annotated[int, Field(ge=1, le=2**32 - 1)] = Field(description="[kbit/s]")
    payment: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(description="[cents per Mbit/s]")


class Uav(Table):
    """A UAV of this host."""

    name: Name
    zone: Annotated[int, Field(ge=1)] = Field(description="that it is stationed in")
    bandwidth: Annotated[int, Field(ge=0, le=2**32 - 1)] = Field(description="that it offers in a period [kbit/s]")


class Coordinator(Table):
    """What this host coordinates, and which newcomers it vouches for."""

    zones: Annotated[list[Annotated[int, Field(ge=1)]], Field(max_length=1_000_000)] = []
    reputations: dict[Address, Annotated[float, Field(ge=0, le=100)]] = {}
    standby: Annotated[float, Field(gt=0, le=3600)] | None = Field(
        None, description="acts only where another has not for so long [s]; None: this one is the first"
    )


class ClockConfig(Table):
    """A run by the clock on the wall; every host has the same table, but for ``off``."""

    slot: Annotated[float, Field(gt=0, le=3600)] = Field(description="what a phase of the selection has [s]")
    step: Annotated[float, Field(gt=0, le=3600)] = Field(description="what a step of flight has [s]")
    begin: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = Field(
        None, description="of the run [s since 1970]; None: when the world says"
    )
    off: Annotated[float, Field(ge=-86400, le=86400)] = Field(0.0, description="of its clock, for trials [s]")


class HostConfig(Table):
    """A host's whole file."""

    name: Name = Field(description="of the host, as the world knows it")
    scenario: str = Field(description="the scenario's file, in its area")
    patience: Annotated[float, Field(gt=0, le=86400)] = Field(
        60.0, description="without a word from the world for so long it is taken to have stopped [s]"
    )
    clock: ClockConfig | None = Field(None, description="by which this host goes; None: it is asked")
    area: Area
    chain: ChainAccess
    store: StoreAccess
    bus: BusAccess
    vehicle: Annotated[list[Vehicle], Field(max_length=100_000)] = []
    uav: Annotated[list[Uav], Field(max_length=100_000)] = []
    coordinator: Coordinator = Coordinator()

    def grid(self) -> ZoneGrid:
        """Of the zones."""
        return self.area.grid()

    def resolved(self) -> ResolvedScenario:
        """The scenario in this area."""
        return resolve(load_scenario(self.scenario), self.grid())

    def law(self) -> Law:
        """Of the area."""
        return Law.of(self.resolved(), self.grid())


TableT = TypeVar("TableT", bound=Table)


def read_table(path: Path, kind: type[TableT]) -> TableT:
    """Read and check a file of one kind.

    Raises:
        UsageError: naming the first key that does not fit.
    """
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise UsageError(path, f"over {MAX_BYTES} bytes", "a host's configuration")
        tree = parse_toml(content.decode("utf-8"))
    except OSError as error:
        raise UsageError(path, None, f"a readable TOML file ({error.strerror})") from error
    except ValueError as error:
        raise UsageError(path, None, f"TOML ({error})") from error
    try:
        return kind.model_validate(tree)
    except ValidationError as error:
        raise _fault(path, error) from None


class ReadAccess(Table):
    """The contract, for who only reads."""

    urls: Annotated[list[str], Field(min_length=1, max_length=40)]
    chain_id: Annotated[int, Field(ge=1)]
    contract: Address
    confirmations: Annotated[int, Field(ge=0, le=1000)] = 0


class WorldConfig(Table):
    """The file of a world's process, as `skyrelay up` writes it."""

    scenario: str = Field(description="the scenario's file")
    folder: str = Field(description="of the run")
    begun: Annotated[float, Field(allow_inf_nan=False)] = Field(description="when the run began (`time.monotonic`)")
    hosts: list[Name] = Field(description="in the order in which they are asked")
    accounts: dict[str, Address] = Field(description="of every member, by name")
    parties: dict[str, Address] = Field(description="of those with a role, by name")
    deciders: dict[str, str] = Field(description="what the UAVs may be told to fly by: names by CID")
    gather: Annotated[float, Field(gt=0)] = Field(description="how long the hosts may take to come [s]")
    wait: Annotated[float, Field(ge=0)] = Field(description="how long the world stands still for a lost host [s]")
    speed: Annotated[float, Field(gt=0)] | None = Field(None, description="of its clock to the wall's, at most")
    clock: ClockConfig | None = None
    chain: ReadAccess
    bus: BusAccess


def load_world(path: Path) -> WorldConfig:
    """Read and check a world's file.

    Raises:
        UsageError: naming the first key that does not fit.
    """
    config = read_table(path, WorldConfig)
    return config.model_copy(update={"bus": config.bus.placed(path.resolve().parent)})


def load_config(path: Path, members: Sequence[str] = ()) -> HostConfig:
    """Read and check a host's file; relative paths in it start from its folder.

    Args:
        members: of those in the file, the ones to host; all where empty.
    Raises:
        UsageError: naming the first key that does not fit, or a member that is not in the file.
    """
    config = read_table(path, HostConfig)
    config = _placed(config, path.resolve().parent)
    if not members:
        return config
    known = {vehicle.name for vehicle in config.vehicle} | {uav.name for uav in config.uav}
    for name in members:
        if name not in known:
            raise UsageError("--members", name, f"a member in {path}")
    wanted = set(members)
    return config.model_copy(
        update={
            "vehicle": [member for member in config.vehicle if member.name in wanted],
            "uav": [member for member in config.uav if member.name in wanted],
        }
    )


def _placed(config: HostConfig, folder: Path) -> HostConfig:
    chain, store = config.chain, config.store
    return config.model_copy(
        update={
            "scenario": str(folder / config.scenario),
            "chain": chain.model_copy(update={"keystore": str(folder / chain.keystore)}),
            "bus": config.bus.placed(folder),
            "store": store if store.path is None else store.model_copy(update={"path": str(folder / store.path)}),
        }
    )


def _fault(path: Path, error: ValidationError) -> UsageError:
    faults = error.errors()
    first = faults[0]
    key = ".".join(str(part) for part in first["loc"])
    more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
    if first["type"] == "extra_forbidden":
        return UsageError(f"{path}: {key}", None, f"a known key{more}")
    if first["type"] == "missing":
        return UsageError(f"{path}: {key}", None, f"a value{more}")
    expected = first["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
    return UsageError(f"{path}: {key}", first["input"], expected + more)
