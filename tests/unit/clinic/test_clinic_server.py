"""The server as people start it: with TLS, without, and refused."""

import datetime
import http.client
import socket
import ssl
import subprocess
import sys
from pathlib import Path
from zoneinfo import available_timezones

import pytest
from tests.clinic_server import command, served

from mammometry.base.errors import SettingsError
from mammometry.clinic.config import ClinicConfig, ClinicError, ServerTls, machine_time_zone, new_clinic, read_config
from mammometry.clinic.site import configure
from mammometry.clinic.web.server import require_current, serve


def certificate(folder: Path) -> tuple[Path, Path]:
    """A certificate for 127.0.0.1 that signs itself, and its key."""
    import ipaddress

    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "clinic")])
    now = datetime.datetime.now(datetime.UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]), critical=False)
        .sign(key, hashes.SHA256())
    )
    (folder / "cert.pem").write_bytes(made.public_bytes(serialization.Encoding.PEM))
    (folder / "key.pem").write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return folder / "cert.pem", folder / "key.pem"


@pytest.mark.slow
def test_a_new_clinic_is_served_with_tls(tmp_path: Path) -> None:
    folder = tmp_path / "clinic"
    answer = command("init", str(folder), "--administrator", "boss")
    assert "/account/invitation/" in str(answer["link"])
    cert, key = certificate(tmp_path)
    with served(folder, "--tls-certificate", str(cert), "--tls-key", str(key)) as (address, _):
        host, port = address.split(":")
        trusting = ssl.create_default_context(cafile=str(cert))
        connection = http.client.HTTPSConnection(host, int(port), context=trusting, timeout=30)
        connection.request("GET", "/account/login/")
        page = connection.getresponse()
        body = page.read().decode()
        assert page.status == 200
        assert "password" in body
        assert page.getheader("Strict-Transport-Security", "").startswith("max-age=31536000")
        cookie = page.getheader("Set-Cookie", "")
        assert cookie.startswith("__Host-clinic-csrf=")
        assert "Secure" in cookie
        assert page.getheader("Server") is None
        # what is too large is refused although nobody is logged in, before it is read
        connection.request("POST", "/account/login/", body=b"x" * 300_000)
        assert connection.getresponse().status == 413
        connection.close()


def test_without_tls_other_machines_are_kept_out(tmp_path: Path) -> None:
    config = new_clinic(tmp_path / "clinic", name="Clinic").model_copy(update={"address": "0.0.0.0:8000"})
    with pytest.raises(ClinicError, match=r"^address 0\.0\.0\.0:8000: .*certificate"):
        serve(config)


def test_a_certificate_that_is_not_there_is_named(tmp_path: Path) -> None:
    config = new_clinic(tmp_path / "clinic", name="Clinic")
    config = config.model_copy(update={"tls": ServerTls(certificate="/nowhere/cert.pem", key="/nowhere/key.pem")})
    with pytest.raises(ClinicError, match=r"/nowhere/cert\.pem"):
        serve(config)


def test_a_clinic_whose_audit_was_unsealed_is_not_served(clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mammometry.clinic.audit.is_sealed", lambda: False)
    monkeypatch.setattr("django.db.migrations.executor.MigrationExecutor.migration_plan", lambda *_: [])
    with pytest.raises(ClinicError, match=r"audit: .*triggers"):
        require_current(clinic)


@pytest.mark.requirement("R-KEEP-4")
def test_a_database_that_waits_for_migrations_is_not_served(
    clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("django.db.migrations.executor.MigrationExecutor.migration_plan", lambda *_: ["one"])
    with pytest.raises(ClinicError, match=r"database: .*older"):
        require_current(clinic)


def test_a_database_with_migrations_that_this_version_lacks_is_not_served(
    clinic: ClinicConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    applied = {("clinic", "0003_deliveries"): None}
    monkeypatch.setattr("django.db.migrations.recorder.MigrationRecorder.applied_migrations", lambda _: applied)
    with pytest.raises(ClinicError, match=r"database: .*another"):
        require_current(clinic)


def test_what_is_secret_is_readable_by_its_owner_alone(tmp_path: Path) -> None:
    folder = tmp_path / "clinic"
    new_clinic(folder, name="Clinic")
    assert folder.stat().st_mode & 0o777 == 0o700
    for name in ("clinic.toml", "secret.key"):
        assert (folder / name).stat().st_mode & 0o777 == 0o600
    assert len(read_config(folder).secret_key) >= 50


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ('time_zone = "Mars"', "time_zone"),
        ("colour = 1", "colour"),
        ('address = "here"', "address"),
        ("[limits]\nidle_minutes = 0", "limits.idle_minutes"),
        ("name = ", "invalid TOML"),
    ],
)
def test_wrong_settings_are_named(tmp_path: Path, line: str, says: str) -> None:
    from mammometry.base.errors import SettingsError

    (tmp_path / "clinic.toml").write_text(line + "\n")
    with pytest.raises(SettingsError, match=says):
        read_config(tmp_path)


def test_any_name_of_a_clinic_survives_its_settings(tmp_path: Path) -> None:
    name = 'St. "Mary\'s" Ward 5 # – Gebäude ü [tls]'
    assert new_clinic(tmp_path / "clinic", name=name).name == name


@pytest.mark.parametrize(
    "address", ["mysql://x/y", "postgresql://u:p@ss@h:port/x y", "postgresql:///n?nonsense=1", "sqlite:///x"]
)
def test_addresses_of_no_database_are_refused_without_saying_the_password(tmp_path: Path, address: str) -> None:
    from mammometry.clinic.site import database

    config = ClinicConfig(folder=tmp_path, database=address)
    with pytest.raises(ClinicError) as refused:
        database(config)
    assert "p@ss" not in str(refused.value)


@pytest.mark.slow
def test_an_address_that_is_not_free_is_refused_before_anything_is_started(tmp_path: Path) -> None:
    from mammometry.clinic.web.server import require_free

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ClinicError, match=rf"^address {address}: .*listens"):
            require_free(address)
        folder = tmp_path / "clinic"
        done = subprocess.run(
            [sys.executable, "-m", "mammometry", "clinic", "demo", str(folder), "--address", address],
            capture_output=True, text=True, check=False, timeout=60,
        )  # fmt: skip
    assert done.returncode == 3
    assert "listens" in done.stderr
    assert not folder.exists()
    require_free(address)


@pytest.mark.parametrize("address", ["192.0.2.1:8000", "127.0.0.1:99999", "nobody.invalid:8000"])
def test_an_address_of_another_machine_is_named(address: str) -> None:
    from mammometry.clinic.web.server import require_free

    with pytest.raises(ClinicError, match=rf"^address {address}: .*port"):
        require_free(address)


def test_settings_that_change_while_a_clinic_is_open_make_no_other_clinic(clinic: ClinicConfig, tmp_path: Path) -> None:
    configure(clinic.model_copy(update={"cameras": {"Room 9": "cameras/rig.toml"}, "address": "127.0.0.1:9"}))
    with pytest.raises(ClinicError, match="another"):
        configure(clinic.model_copy(update={"folder": tmp_path}))


def test_a_demo_is_configured_with_the_cameras_that_it_will_have(tmp_path: Path) -> None:
    from mammometry.clinic.demo import _with_cameras

    config = _with_cameras(new_clinic(tmp_path / "clinic", name="Demo"))
    assert config == read_config(config.folder)
    assert list(config.cameras) == ["Room 1"]


def test_a_new_clinic_has_the_machines_time_zone_or_the_one_that_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TZ", "Pacific/Auckland")
    assert machine_time_zone() == "Pacific/Auckland"
    monkeypatch.setenv("TZ", "Mars/Olympus")
    assert machine_time_zone() in available_timezones()
    assert new_clinic(tmp_path / "one", name="Clinic", time_zone="Asia/Tokyo").time_zone == "Asia/Tokyo"
    with pytest.raises(SettingsError):
        new_clinic(tmp_path / "two", name="Clinic", time_zone="Mars/Olympus")
    assert not (tmp_path / "two").exists()
