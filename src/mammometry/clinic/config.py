"""A clinic's settings: ``clinic.toml`` in its folder.

The folder also contains the secret key, the database (unless PostgreSQL), the sessions with their photographs, the
rigs, running uploads, backups and logs.
"""

from __future__ import annotations

import os
import secrets
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, BinaryIO, Literal
from zoneinfo import available_timezones

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from mammometry.base.errors import MammometryError, SettingsError
from mammometry.base.parse import read_text, toml_table
from mammometry.hospital.codes import require_text, text_fault
from mammometry.hospital.peers import require_encrypted

if TYPE_CHECKING:
    from mammometry.settings import Settings

FILE = "clinic.toml"
KEY_FILE = "secret.key"
SETTINGS_FILE = "settings.toml"
"""Settings of all measurements, in the clinic's folder. Defaults apply without it."""
OPENID_SECRET_FILE = "openid.secret"
FOLDERS = ("sessions", "rigs", "acceptance", "uploads", "backups", "logs")
_STRICT = ConfigDict(extra="forbid", strict=True, frozen=True)
_KEY_BYTES = 48  # random bytes in the secret key; Django wants at least 50 characters


class ClinicError(MammometryError):
    """An error in the clinic's folder, database or people."""

    exit_code = 3
    code = "clinic"


def _is_time_zone(name: str) -> str:
    if name not in available_timezones():
        raise ValueError("a time zone such as Europe/Berlin")
    return name


def _is_organization(name: str) -> str:
    if (fault := text_fault(name, "LO")) is not None:
        raise ValueError(fault[1])
    return name


def _are_encrypted(secrets_of: dict[str, str]) -> dict[str, str]:
    for address in secrets_of:
        try:
            require_encrypted(address)
        except MammometryError as error:
            raise ValueError(f"https in {address}: {error.expected}") from None
    return secrets_of


Filled = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class ServerTls(BaseModel):
    """Encryption of the connection."""

    model_config = _STRICT

    certificate: str = ""
    """PEM file of the certificate with its chain; empty: none."""
    key: str = ""
    """PEM file of the certificate's key."""
    behind_proxy: bool = False
    """A proxy on this machine (127.0.0.1) handles TLS and forwards requests."""

    @property
    def used(self) -> bool:
        """Whether browsers use TLS."""
        return self.behind_proxy or bool(self.certificate)


class RateLimits(BaseModel):
    """Limits for one person or address."""

    model_config = _STRICT

    idle_minutes: Annotated[int, Field(ge=1, le=24 * 60)] = 30
    """Minutes without a request after which a person is logged out."""
    session_hours: Annotated[int, Field(ge=1, le=24 * 7)] = 12
    """Hours after which a person must log in again, idle or not."""
    wrong_passwords: Annotated[int, Field(ge=3, le=100)] = 8
    """Wrong passwords for one name from one address before it is locked."""
    wait_minutes: Annotated[int, Field(ge=1, le=24 * 60)] = 15
    """Duration of the lock."""
    requests_per_second: Annotated[int, Field(ge=1, le=100_000)] = 100
    """Average number of requests per second from one address; bursts of ten seconds' worth are allowed."""
    request_s: Annotated[int, Field(ge=1, le=600)] = 30
    """Seconds for receiving a request; large requests get more time, at 10 kB a second."""
    photograph_mb: Annotated[int, Field(ge=1, le=2000)] = 150
    """Largest photograph, MB."""
    photograph_megapixels: Annotated[int, Field(ge=1, le=1000)] = 250
    """Largest photograph, millions of pixels."""
    video_mb: Annotated[int, Field(ge=1, le=4000)] = 500
    """Largest video of a telephone, MB. 30 s of 4K at 60 frames a second and 100 Mbit/s are 375."""
    scan_mb: Annotated[int, Field(ge=1, le=500)] = 200
    """Largest scan of another device, MB, unpacked and with its pictures."""


class People(BaseModel):
    """Rules for logging in."""

    model_config = _STRICT

    second_factor: Literal["required", "offered"] = "required"
    """Whether everybody needs a code from an authenticator in addition to the password."""


class Backup(BaseModel):
    """The server's automatic daily backup."""

    model_config = _STRICT

    daily_at: Annotated[str, StringConstraints(pattern=r"^(([01]\d|2[0-3]):[0-5]\d)?$")] = "02:30"
    """Time of day in the clinic's zone; empty: no automatic backups."""
    folder: str = ""
    """Folder of the backups; empty: ``backups`` in the clinic's folder. Use another disk."""
    keep: Annotated[int, Field(ge=1, le=1000)] = 3
    """Number of backups; older ones are deleted after a new one is complete."""


class Rigs(BaseModel):
    """Tests of the rigs."""

    model_config = _STRICT

    acceptance_days: Annotated[int, Field(ge=0, le=3650)] = 0
    """Days after which a rig's page asks for a new acceptance test; 0: never."""


class OpenId(BaseModel):
    """The hospital's own login by OpenID Connect. Its secret is in the file openid.secret."""

    model_config = _STRICT

    name: Filled
    """Its name on the login page."""
    server: Filled
    """Address of the server, such as https://login.hospital.example/realms/main."""
    client: Filled
    """The clinic's name there."""


class ClinicConfig(BaseModel):
    """Settings of one clinic."""

    model_config = _STRICT

    folder: Path
    """The clinic's folder."""
    name: Annotated[Filled, AfterValidator(_is_organization)] = "Clinic"
    """Name on pages, and the DICOM organization of people who confirm results."""
    address: Annotated[str, StringConstraints(pattern=r"^[^\s:]+:\d{1,5}$")] = "127.0.0.1:8000"
    """Address of the server: host:port."""
    hosts: tuple[Filled, ...] = ("localhost", "127.0.0.1")
    """Host names that browsers may use."""
    time_zone: Annotated[str, AfterValidator(_is_time_zone)] = "UTC"
    """Time zone of dates on pages; the database uses UTC."""
    database: str = "sqlite"
    """``sqlite``, or ``postgresql://user:password@host:port/name``."""
    cluster: str = ""
    """Dask scheduler (tcp://…) that measures; empty: this machine."""
    tls: ServerTls = ServerTls()
    limits: RateLimits = RateLimits()
    people: People = People()
    backup: Backup = Backup()
    rigs: Rigs = Rigs()
    openid: OpenId | None = None
    cameras: dict[Filled, Filled] = {}
    """Name of a rig that is connected to this computer → its rig.toml, relative to the clinic's folder."""

    stow_secrets: Annotated[dict[Filled, Filled], AfterValidator(_are_encrypted)] = {}
    """Address of a DICOMweb archive → the file with its login ("Bearer …"), relative to the clinic's folder. It is sent
    only to this address, whichever address is entered on a page.
    """

    def stow_secret(self, address: str) -> str | None:
        """Login for a DICOMweb archive. None if it needs none.

        Raises:
            ClinicError: its file is missing or empty.
        """
        files = {named.rstrip("/"): file for named, file in self.stow_secrets.items()}
        file = files.get(address.rstrip("/"))
        return None if file is None else _secret(self.folder / file, least=1)

    def measuring(self) -> Settings:
        """The clinic's measurement settings: its settings.toml, or the defaults.

        Everything that opens a session must use them, because results would be computed again with others.

        Raises:
            SettingsError: the file is invalid.
        """
        from mammometry.settings import Settings

        path = self.folder / SETTINGS_FILE
        return Settings.load(path) if path.is_file() else Settings()

    @property
    def backups(self) -> Path:
        """Folder of the backups."""
        return Path(self.backup.folder) if self.backup.folder else self.folder / "backups"

    @property
    def secret_key(self) -> str:
        """Read the key that signs sessions.

        Raises:
            ClinicError: the file is missing or too short.
        """
        return _secret(self.folder / KEY_FILE, least=50)

    @property
    def openid_secret(self) -> str:
        """Read the clinic's secret for the hospital's login.

        Raises:
            ClinicError: the file is missing or empty.
        """
        return _secret(self.folder / OPENID_SECRET_FILE, least=1)


def host_and_port(address: str) -> tuple[str, int]:
    """Host and port of an address.

    Raises:
        ClinicError: it is not of the form host:port.
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        remedy = "Write it like 127.0.0.1:8000"
        raise ClinicError("the address", found=repr(address), expected="host:port", remedy=remedy)
    return host, int(port)


def _secret(path: Path, least: int) -> str:
    try:
        text = path.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        text = ""
    if len(text) < least:
        found = f"{len(text)} characters"
        remedy = "Put it back from a backup"
        raise ClinicError(path.name, found=found, expected=f"at least {least} characters of ASCII", remedy=remedy)
    return text


def read_config(folder: Path) -> ClinicConfig:
    """Read a clinic's settings.

    Raises:
        ClinicError: there is no clinic in the folder.
        SettingsError: a setting has an unknown name or a wrong value.
    """
    path = folder / FILE
    if not path.is_file():
        remedy = f"Make one with `mammometry clinic init {folder}`"
        raise ClinicError(str(folder), found=f"no {FILE}", expected="the folder of a clinic", remedy=remedy)
    what = "a clinic's settings"
    text = read_text(path, FILE, what, refusal=SettingsError)
    table = toml_table(text, FILE, what, refusal=SettingsError)
    if isinstance(hosts := table.get("hosts"), list):
        table["hosts"] = tuple(hosts)
    try:
        return ClinicConfig.model_validate({**table, "folder": folder.resolve()})
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"]) or "the settings"
        remedy = "docs/how-to/clinic-administrator.md lists all settings"
        raise SettingsError(f"{FILE}, {name}", found="a wrong value", expected=first["msg"], remedy=remedy) from None


def machine_time_zone() -> str:
    """The time zone of this machine, such as Europe/Berlin. UTC if unknown."""
    found = [os.environ.get("TZ", "").removeprefix(":")]
    with suppress(OSError):
        found.append(Path("/etc/timezone").read_text(encoding="ascii", errors="replace").strip())
    found.append(os.path.realpath("/etc/localtime").rpartition("/zoneinfo/")[2])
    return next((name for name in found if name in available_timezones()), "UTC")


def new_clinic(
    folder: Path, *, name: str, database: str = "sqlite", second_factor: str = "required", time_zone: str = "UTC"
) -> ClinicConfig:
    """Make the folder of a clinic: settings, secret key, empty folders.

    Raises:
        ClinicError: the folder is not empty.
        SettingsError: the name is invalid, or the time zone unknown.
    """
    require_text(name, "LO", "the clinic's name")
    if time_zone not in available_timezones():
        remedy = "Name it as the IANA database does"
        raise SettingsError("time_zone", found=repr(time_zone), expected="one such as Europe/Berlin", remedy=remedy)
    if folder.exists() and any(folder.iterdir()):
        remedy = "Name a new folder, or open this one with `mammometry clinic serve`"
        raise ClinicError(str(folder), found="files", expected="a new or empty folder", remedy=remedy)
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder.chmod(0o700)
    for kept in FOLDERS:
        (folder / kept).mkdir(mode=0o700)
    write_private(folder / KEY_FILE, secrets.token_urlsafe(_KEY_BYTES) + "\n")
    write_private(folder / FILE, _TEMPLATE.format(*map(quoted, (name, time_zone, database, second_factor))))
    return read_config(folder)


def new_private(path: Path) -> BinaryIO:
    """Open a new file that only its owner can read. Replaces a file that a killed process has left."""
    path.unlink(missing_ok=True)  # it may have wider permissions, which opening would keep
    return open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb")


def write_private(path: Path, text: str) -> None:
    """Write a small private file atomically."""
    beside = path.with_name(path.name + ".new")
    with new_private(beside) as file:
        file.write(text.encode())
        file.flush()
        os.fsync(file.fileno())
    beside.replace(path)


def quoted(text: str) -> str:
    """A text as a TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(letter if letter.isprintable() else f"\\u{ord(letter):04x}" for letter in escaped) + '"'


_TEMPLATE = """\
# A clinic of mammometry. docs/how-to/clinic-administrator.md says what each line does.
name = {}
address = "127.0.0.1:8000"            # host:port where the server listens
hosts = ["localhost", "127.0.0.1"]    # names under which browsers may call it
time_zone = {}                     # of dates on pages, such as "Europe/Berlin"
database = {}                   # or "postgresql://user:password@host/name"
cluster = ""                          # a Dask scheduler, "tcp://host:8786"; empty: this machine

[tls]
certificate = ""                      # PEM files; without them only this machine can call the server
key = ""
behind_proxy = false                  # true: a proxy on this machine speaks TLS

[people]
second_factor = {}            # or "offered"

[backup]
daily_at = "02:30"                    # in the time zone above; "": none
folder = ""                           # empty: backups in this folder; better: on another disk
keep = 3                              # older ones are deleted
"""
