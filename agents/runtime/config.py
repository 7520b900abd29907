"""Options of the commands for the control loop and the simulator."""

import os
import re
import secrets
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from surface_gym import checks

if TYPE_CHECKING:
    from surface_gym.config import EnvConfig

TOKEN = "SURFACE_GYM_TOKEN"  # environment variable
TOKEN_FILE = Path("runs/runtime/token")
SHORTEST_TOKEN = 16  # characters
OPC_UA = "opc.tcp://"  # beginning of an address
LOOPBACK = ("127.0.0.1", "localhost", "::1")  # hosts that are this computer


@dataclass(frozen=True)
class WorldOptions:
    """Options of a simulated machine."""

    pause: float = 0.3  # [s] from a parcel's departure to the next entry
    encoders: bool = False  # whether frames include the angles of the axes
    # [s] from a picture of a stream to its message; None: as the preset's camera
    late: float | None = None
    lost: float = 0.0  # [-] probability of a stream's parcel to be missing in a picture
    false: float = 0.0  # [-] mean number of false poses in a picture, per parcel on the surface
    merged: float = 0.0  # [-] probability of two touching parcels to be seen as one
    shift: float = 3600.0  # [s] until a stream begins anew, on an empty surface
    rate: float | None = None  # [parcels/h] of a stream; None: the task's
    gate: bool = False  # whether the controller lets a stream's parcels in
    most: int | None = None  # maximum parcels on the surface; None: the task's

    def __post_init__(self) -> None:
        checks.not_negative("pause", self.pause)
        for name in ("lost", "false", "merged"):
            checks.within(name, getattr(self, name), 0.0, 1.0)
        if self.late is not None:
            checks.not_negative("late", self.late, 1.0)
        checks.positive("shift", self.shift, most=checks.EPISODE)


@dataclass(frozen=True)
class RuntimeConfig:
    """Run an agent in real time, on a new simulator or on a device at an address."""

    name: tyro.conf.Positional[str]
    """Name of a shipped agent, e.g. stop-ppo, or folder of a trained policy; "excitation" brakes
    and steers the parcels of --task, so that a log tells how the surface acts.
    """
    seed: int | None = None
    """Seed of a shipped agent's policy; the default is the first."""
    task: str | None = None
    """Custom task of the policy, as path/to/file.py:Class; or the task of an excitation."""
    minutes: float = 10.0
    """Duration of the run in minutes."""
    preset: str = "lab"
    """Preset of the machine: friction, noise and turning axes of the filter and the simulator."""
    estimate: Path | None = None
    """File of the surface identified by surface-gym identify, which changes the preset."""
    address: str | None = None
    """Address of a running device, host:port, or opc.tcp://host:port of an OPC UA server; the
    default starts a simulator."""
    token_file: Path | None = None
    """File with the token of a running device; the default is SURFACE_GYM_TOKEN, or no token."""
    certificates: Path | None = None
    """Folder with own.der, own.pem and peer.der, for OPC UA with an encrypted connection."""
    nodes: str | None = None
    """Beginning of the OPC UA variables' node ids, e.g. ns=4;s=Surface.; the default is found."""
    watchdog: float = 0.2
    """Seconds without a frame, or without the acknowledgement of a command, after which the fixed
    layout replaces the policy.
    """
    start: int = 0
    """Seed of the simulator's parcels and noise."""
    world: WorldOptions = field(default_factory=WorldOptions)
    """Options of the simulator."""
    log: Path | None = None
    """New file for all messages, e.g. run.jsonl.gz, from which surface-gym identify learns."""
    mqtt: str | None = None
    """Address of an MQTT broker, host:port, for telemetry; see also mqtt-user."""
    mqtt_user: str | None = None
    """User at the broker; others than 127.0.0.1 need mqtt-ca."""
    mqtt_password_file: Path | None = None
    """File with the user's password, readable by its owner only."""
    mqtt_ca: Path | None = None
    """Certificate of the authority that signed the broker's, for a connection by TLS."""
    out: Path = Path("runs/runtime")
    """Folder for report.json and the simulator's log."""

    def __post_init__(self) -> None:
        checks.positive("minutes", self.minutes)
        checks.positive("watchdog", self.watchdog)
        for address in (self.address, self.mqtt):
            if address is not None:
                parse_address(address)


@dataclass(frozen=True)
class SimulatorConfig:
    """Simulate an environment in real time, as a device for a control loop."""

    task: str = "stop"
    """Task of the package, or custom task as path/to/file.py:Class."""
    preset: str = "lab"
    """Preset of the machine."""
    estimate: Path | None = None
    """File of an identified surface, which changes the preset."""
    control_period: float = 0.04
    """Seconds between decisions; the task's time limit is a number of decisions."""
    port: int = 0
    """Port on this machine; 0: any free port, which is printed."""
    opcua: int | None = None
    """Port of an OPC UA server in place of the socket; 0: any free port."""
    host: str = LOOPBACK[0]
    """Address where the OPC UA server listens; others than 127.0.0.1 need certificates."""
    certificates: Path | None = None
    """Folder with own.der, own.pem and peer.der, for OPC UA with an encrypted connection."""
    seed: int = 0
    """Seed of all random numbers."""
    token_file: Path | None = None
    """Token file, created if missing; the default is SURFACE_GYM_TOKEN, then runs/runtime/token."""
    parent: int | None = None
    """Process whose end also ends the simulator."""
    world: WorldOptions = field(default_factory=WorldOptions)


def make_env_config(config: RuntimeConfig | SimulatorConfig, **given: Any) -> "EnvConfig":
    """Return an `EnvConfig` with the preset and (if given) the identified surface of `config`."""
    from surface_gym.config import EnvConfig
    from surface_gym.machine.estimate import Estimate

    made = EnvConfig(**given, preset=config.preset)
    return made if config.estimate is None else Estimate.load(config.estimate).adapt(made)


def parse_address(text: str) -> tuple[str, int]:
    """Return the host and the port of "host:port" or "opc.tcp://user@host:port/path"."""
    place = text
    if text.startswith(OPC_UA):
        place = text.removeprefix(OPC_UA).partition("/")[0].rpartition("@")[2]
    host, colon, port = place.rpartition(":")
    if not colon or not host or not re.fullmatch("[0-9]{1,5}", port) or not 0 < int(port) < 65536:
        raise ValueError(f"address must be host:port, got {text!r}")
    return host, int(port)


def read_secret(name: str, file: Path) -> str:
    """Return the text of a file. If users other than the owner have access, raise a ValueError."""
    check_private(name, file)
    return file.read_text().strip()


def check_private(name: str, file: Path) -> None:
    """Raise a ValueError if users other than the owner can read, write or execute a file."""
    if file.stat().st_mode & 0o077:
        raise ValueError(f"{name} must have the mode 600, got {file.stat().st_mode:o}")


def find_token(file: Path | None, make: bool = False) -> str | None:
    """Return the token in a file or in the environment variable `TOKEN`; None if there is no token.

    Args:
        file: file with the token, accessible to the file's owner only. If `file` is None, the
            variable is used. If the variable is not set and `make` is true, `TOKEN_FILE` is used.
        make: whether to make the file, with a random token, if the file does not exist.

    Raises:
        ValueError: other users have access to the file, or the token is too short.
    """
    token = os.environ.get(TOKEN, "") if file is None else ""
    if not token:
        if file is None and not make:
            return None
        file = file or TOKEN_FILE
        if make and not file.exists():
            file.parent.mkdir(parents=True, exist_ok=True)
            with open(os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as made:
                made.write(secrets.token_hex() + "\n")
        token = read_secret("token_file", file)
    if len(token) < SHORTEST_TOKEN:
        raise ValueError(
            f"token must have at least {SHORTEST_TOKEN} characters, got {len(token)} of them"
        )
    return token
