"""The container's steps, run in a bare Debian: installed, made with PostgreSQL, served with TLS, backed up."""

import http.client
import os
import re
import shlex
import shutil
import ssl
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import certifi
import psutil
import pytest
import yaml
from tests.clinic_server import free_port
from tests.postgresql import ABSENT, binaries, server

MIRROR = "http://deb.debian.org/debian"
_KEPT = ("PIP_INDEX_URL", "PIP_EXTRA_INDEX_URL", "http_proxy", "https_proxy", "no_proxy")


def containerfile(repository: Path) -> list[tuple[str, str]]:
    """Its instructions, in order."""
    lines = (repository / "deploy/Containerfile").read_text(encoding="utf-8").splitlines()
    pairs = [line.split(maxsplit=1) for line in lines if line and not line.startswith("#")]
    return [(word, rest) for word, rest in pairs]


class Root:
    """A Debian in a folder, in which commands run with processes and mounts of their own."""

    def __init__(self, folder: Path, shared: Path) -> None:
        """Take a folder with a Debian, and one that both sides see under the same path."""
        self.folder, self._shared, self.user = folder, shared, "root"
        shutil.copy("/etc/resolv.conf", folder / "etc/resolv.conf")
        shutil.copy(ssl.get_default_verify_paths().cafile or certifi.where(), folder / "certificates.pem")
        (folder / shared.relative_to("/")).mkdir(parents=True)

    def start(self, command: str, **more: Any) -> "subprocess.Popen[str]":
        """Start a shell's line as the user whose turn it is."""
        folder = shlex.quote(str(self.folder))
        kept = [f"{name}={os.environ[name]}" for name in _KEPT if name in os.environ]
        inside = ["env", "-i", "PATH=/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LC_ALL=C.UTF-8"]
        inside += ["PIP_CERT=/certificates.pem", *kept]
        inside += ["chroot", f"--userspec={self.user}", str(self.folder), "/bin/sh", "-c", command]
        mounts = (
            f"mount -t proc proc {folder}/proc && mount --bind {self._shared} {folder}{self._shared} "
            f"&& mount --rbind /dev {folder}/dev && exec {shlex.join(inside)}"
        )
        words = ["unshare", "--mount", "--pid", "--fork", "/bin/sh", "-c", mounts]
        return subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, **more)

    def run(self, command: str) -> str:
        """What a command prints; it must succeed."""
        with self.start(command) as running:
            printed = running.communicate(timeout=900)[0]
        assert running.returncode == 0, (command, printed)
        return printed


def is_alive(address: str) -> bool:
    """Whether the clinic's server answers."""
    connection = http.client.HTTPSConnection(address, timeout=5, context=ssl._create_unverified_context())
    try:
        connection.request("GET", "/alive/")
        return connection.getresponse().status == 200
    except OSError:
        return False
    finally:
        connection.close()


def test_the_compose_file_starts_what_the_containerfile_makes(repository: Path) -> None:
    compose = yaml.safe_load((repository / "deploy/compose.yaml").read_text(encoding="utf-8"))
    services = compose["services"]
    steps = dict(containerfile(repository))
    assert (repository / services["clinic"]["build"]["dockerfile"]).is_file()
    assert {name for service in services.values() for name in service["secrets"]} == set(compose["secrets"])
    mounted = {volume.partition(":")[0] for service in services.values() for volume in service["volumes"]}
    assert mounted == set(compose["volumes"])
    assert services["clinic"]["depends_on"] == {"database": {"condition": "service_healthy"}}
    assert services["database"]["healthcheck"]["test"][1] == "pg_isready"
    given = services["database"]["environment"]
    address = f"postgresql://{given['POSTGRES_USER']}:$(cat password.txt)@database/{given['POSTGRES_DB']}"
    assert address in (repository / "docs/how-to/clinic-administrator.md").read_text(encoding="utf-8")
    assert services["clinic"]["volumes"] == [f"clinic:{steps['VOLUME']}"]
    assert services["clinic"]["ports"] == [f"{steps['EXPOSE']}:{steps['EXPOSE']}"]
    assert {f"/run/secrets/{name}" for name in services["clinic"]["secrets"]} <= set(yaml.safe_load(steps["CMD"]))


@pytest.mark.slow
def test_the_containers_steps_make_a_clinic_that_is_served_and_backed_up(repository: Path, tmp_path: Path) -> None:
    if os.geteuid() != 0 or shutil.which("mmdebstrap") is None:
        pytest.skip("a bare Debian is made by root with mmdebstrap (apt-get install mmdebstrap)")
    if binaries() is None:
        pytest.skip(ABSENT)
    (repository / "dist").mkdir(exist_ok=True)
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w"]
    subprocess.run([*build, str(tmp_path / "dist"), "."], cwd=repository, check=True, timeout=600)
    for name in ("constraints.txt", "deploy"):
        (tmp_path / name).symlink_to(repository / name)
    steps = containerfile(repository)
    ((_, image), *_) = steps
    suite = re.fullmatch(r"docker.io/library/debian:(\w+)-slim", image)
    assert suite is not None
    made = ["mmdebstrap", "--quiet", "--mode=root", "--variant=apt", "--components=main", suite[1]]
    subprocess.run([*made, str(tmp_path / "root"), MIRROR], check=True, timeout=900)
    secrets = tmp_path / "root/run/secrets"
    secrets.mkdir(parents=True)
    certificate = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-subj", "/CN=localhost"]
    subprocess.run(
        [*certificate, "-keyout", secrets / "key", "-out", secrets / "certificate"], check=True, capture_output=True
    )
    (secrets / "key").chmod(0o644)
    with server() as address:
        shared = Path(address.rpartition("host=")[2])
        shared.chmod(0o755)
        root = Root(tmp_path / "root", shared)
        entry, command = [], []
        for word, rest in steps[1:]:
            if word == "COPY":
                *sources, target = rest.split()
                place = root.folder / target.removeprefix("/")
                for path in (path for source in sources for path in tmp_path.glob(source)):
                    copied = place if path.is_dir() else place / path.name
                    copied.parent.mkdir(parents=True, exist_ok=True)
                    (shutil.copytree if path.is_dir() else shutil.copy)(path, copied)
            elif word == "RUN":
                root.run(rest)
            elif word == "USER":
                root.user = rest
            elif word in ("ENTRYPOINT", "CMD"):
                (entry if word == "ENTRYPOINT" else command).extend(yaml.safe_load(rest))
        clinic = shlex.join(entry)
        root.run(f"{clinic} init /srv/clinic --database {shlex.quote(address)} --administrator boss")
        assert "current" in root.run(f"{clinic} upgrade /srv/clinic")
        listening = f"127.0.0.1:{free_port()}"
        serve = [listening if word == "0.0.0.0:8443" else word for word in command]
        assert listening in serve
        with root.start(f"exec {clinic} {shlex.join(serve)}") as running:
            try:
                until = time.monotonic() + 120
                while not is_alive(listening):
                    assert running.poll() is None, running.communicate()[0]
                    assert time.monotonic() < until, "no answer"
                    time.sleep(0.5)
                backup = (repository / "deploy/clinic-backup.service").read_text(encoding="utf-8")
                lines = re.findall(r"^ExecStart=(.+)$", backup, re.MULTILINE)
                assert [root.run(line) for line in lines]
            finally:
                for first in psutil.Process(running.pid).children():
                    first.kill()  # and all in its namespace; a change of the user keeps it from ending with its parent
        assert len(list((root.folder / "srv/clinic/backups").glob("*.tar"))) == 1
    root.user = "root"
    root.run("apt-get install -y -qq --no-install-recommends docker-compose systemd")
    root.run("docker-compose -f /build/deploy/compose.yaml config --quiet")
    assert root.run("systemd-analyze verify /build/deploy/*.service /build/deploy/*.timer") == ""
