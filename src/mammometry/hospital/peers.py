"""Addresses of other systems, as entered by people."""

from __future__ import annotations

import ipaddress
import re
import ssl
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from mammometry.base.errors import SettingsError
from mammometry.hospital.codes import text_fault

AUTHORIZATION = "MAMMOMETRY_STOW_AUTHORIZATION"
"""Environment variable with the Authorization header, for commands; an address would be visible to others. A clinic has
a secret for each archive (`clinic.config`).
"""
_PEER = re.compile(r"^(?P<title>[^@]{1,16})@(?P<host>\[[0-9a-fA-F:.]+\]|[A-Za-z0-9_.-]+):(?P<port>[0-9]{1,5})$")


@dataclass(frozen=True, slots=True, kw_only=True)
class Peer:
    """A DICOM application: its title and address."""

    title: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> Peer:
        """Read ``AE@host:port``.

        Raises:
            SettingsError: it has another form.
        """
        match = _PEER.match(text)
        if match is None or text_fault(match["title"], "AE") is not None or not 0 < int(match["port"]) < 65536:
            remedy = "Ask the archive's administrator for them"
            expected = "AE@host:port, such as PACS@10.0.0.5:104"
            raise SettingsError(
                text or "the archive's address", found="no AE title, host and port", expected=expected, remedy=remedy
            )
        return cls(title=match["title"].strip(), host=match["host"].strip("[]"), port=int(match["port"]))

    def __str__(self) -> str:
        return f"{self.title}@{self.host}:{self.port}"


@dataclass(frozen=True, slots=True, kw_only=True)
class PeerTls:
    """Encryption of a connection."""

    authorities: Path | None = None
    """Certificate authorities of the other side (PEM). None: those that the system trusts."""
    certificate: Path | None = None
    """Our own certificate, if the other side requires one (PEM)."""
    key: Path | None = None
    """Its private key (PEM). None: in the certificate's file."""

    def context(self) -> ssl.SSLContext:
        """Return the SSL context.

        Raises:
            SettingsError: a file is missing or not a certificate.
        """
        try:
            made = ssl.create_default_context(cafile=None if self.authorities is None else str(self.authorities))
            if self.certificate is not None:
                made.load_cert_chain(self.certificate, self.key)
        except OSError as error:  # includes SSLError
            files = ", ".join(str(path) for path in (self.authorities, self.certificate, self.key) if path is not None)
            remedy = "Check the files of --tls-ca, --tls-certificate and --tls-key"
            expected = "certificates and a key as PEM"
            raise SettingsError(
                files or "TLS", found=f"no certificate that can be read ({error})", expected=expected, remedy=remedy
            ) from None
        return made


def web_address(url: str) -> str:
    """Return the address without a trailing slash.

    Raises:
        SettingsError: not an HTTP address, or one with a password.
    """
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.query or parts.fragment:
        remedy = "Ask the archive's administrator for it"
        expected = "such as https://pacs.example.org/dicom-web"
        raise SettingsError(url, found="no address of a DICOMweb service", expected=expected, remedy=remedy)
    if parts.username or parts.password:
        remedy = "Addresses are shown and logged: leave it out of the address"
        expected = f"the variable {AUTHORIZATION} in the environment, such as 'Basic …' or 'Bearer …'"
        raise SettingsError(parts.hostname, found="a name or password in the address", expected=expected, remedy=remedy)
    return url.rstrip("/")


def require_encrypted(url: str) -> str:
    """Return an address to which a login may be sent: https, or this machine itself.

    Raises:
        SettingsError: any other address.
    """
    parts = urlsplit(web_address(url))
    if parts.scheme != "https" and not is_loopback(parts.hostname or ""):
        remedy = "Ask the archive's administrator for its https address"
        expected = "https, because the archive's login is sent with each request"
        raise SettingsError(url, found="an address without encryption", expected=expected, remedy=remedy)
    return url


def is_loopback(host: str) -> bool:
    """Whether a host is this machine itself."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
