"""An Orthanc for tests, which they start and end themselves: a DICOM archive with C-STORE, C-FIND and DICOMweb."""

import json
import resource
import shutil
import socket
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ABSENT = "no Orthanc is installed (apt-get install orthanc orthanc-dicomweb): tests with one are left out"
_PLUGINS = Path("/usr/share/orthanc/plugins")


def program() -> str | None:
    """Where it is; Debian does not put it on everybody's path."""
    return shutil.which("Orthanc") or shutil.which("Orthanc", path="/usr/sbin:/usr/local/sbin")


def free_port() -> int:
    with closing(socket.socket()) as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


@dataclass
class Orthanc:
    """One that runs, with its folder and its ports."""

    folder: Path
    dicom: int
    http: int
    settings: dict[str, Any] = field(default_factory=dict)
    running: "subprocess.Popen[bytes] | None" = None

    @property
    def peer(self) -> str:
        return f"ORTHANC@127.0.0.1:{self.dicom}"

    @property
    def web(self) -> str:
        return f"http://127.0.0.1:{self.http}/dicom-web"

    def get(self, path: str) -> Any:
        with urllib.request.urlopen(f"http://127.0.0.1:{self.http}{path}", timeout=20) as answer:
            content = answer.read()
        return json.loads(content) if answer.headers.get_content_type() == "application/json" else content

    def instances(self) -> dict[str, bytes]:
        """SOP Instance UID → the file as it was stored, of everything."""
        made = {}
        for key in self.get("/instances"):
            about = self.get(f"/instances/{key}")
            made[about["MainDicomTags"]["SOPInstanceUID"]] = self.get(f"/instances/{key}/file")
        return made

    def start(self) -> None:
        binary = program()
        assert binary is not None, ABSENT
        settings = {
            "StorageDirectory": str(self.folder / "storage"),
            "IndexDirectory": str(self.folder / "storage"),
            "Plugins": [
                str(path)
                for path in (_PLUGINS / "libOrthancDicomWeb.so", _PLUGINS / "libModalityWorklists.so")
                if path.exists()
            ],
            "DicomAet": "ORTHANC",
            "DicomPort": self.dicom,
            "HttpPort": self.http,
            "AuthenticationEnabled": False,
            "RemoteAccessAllowed": False,
            "DicomCheckCalledAet": True,
            "DicomAlwaysAllowFind": True,
            "DicomAlwaysAllowFindWorklist": True,
            "DicomAlwaysAllowStore": True,
            "OverwriteInstances": False,
            "DicomWeb": {"Enable": True, "Root": "/dicom-web/"},
            **self.settings,
        }
        (self.folder / "storage").mkdir(exist_ok=True)
        file = self.folder / "orthanc.json"
        file.write_text(json.dumps(settings))
        with (self.folder / "log").open("ab") as log:
            self.running = subprocess.Popen(
                [binary, str(file)], stdout=log, stderr=log, cwd=self.folder,
                restore_signals=False,  # Python ignores SIGXFSZ: a write beyond `fill` fails, as on a full disk
            )  # fmt: skip
        for _ in range(300):
            try:
                self.get("/system")
                return
            except OSError:
                assert self.running.poll() is None, (self.folder / "log").read_text()[-2000:]
                time.sleep(0.1)
        raise AssertionError("Orthanc did not start")

    def fill(self, largest_bytes: int | None) -> None:
        """No file grows beyond this any more, as if the disk were full. None: there is room again."""
        assert self.running is not None
        most = resource.RLIM_INFINITY if largest_bytes is None else largest_bytes
        resource.prlimit(self.running.pid, resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))

    def stop(self, *, kill: bool = False) -> None:
        if self.running is not None:
            self.running.kill() if kill else self.running.terminate()
            self.running.wait(30)
            self.running = None


@contextmanager
def server(folder: Path, **settings: Any) -> Iterator[Orthanc]:
    """A new, empty archive in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    made = Orthanc(folder=folder, dicom=free_port(), http=free_port(), settings=settings)
    try:
        made.start()
        yield made
    finally:
        made.stop()
