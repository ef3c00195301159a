"""A demo clinic's first day over HTTP: made and served by one command, entered by each role, its first visit measured.

``python -m tests.clinic_day_one make clinic``, or any other command that makes a demo and serves it. Needs the standard
library alone, so that it can look at a fresh clone.
"""

import http.cookiejar
import os
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

_MADE_S = 600  # installation on a slow line, and the demo
_MEASURED_S = 600  # one small visit; seconds, but on a machine with much else to do
_STOPPED_S = 40
_PASSWORD = re.compile(r"Log in as (\w+), password (\S+)")
_ADDRESS = re.compile(r"(http://\S+/) \(Ctrl-C stops\)")
_TOKEN = re.compile(r'name="csrfmiddlewaretoken" value="([^"]+)"')
_OWN_PAGES = {"technician": "rigs/", "clinician": "patients/", "researcher": "study/", "administrator": "archives/"}


class DayOneError(Exception):
    """The first day did not go as it must."""


class Browser:
    """One person's way through the pages."""

    def __init__(self, address: str) -> None:
        self._address = address
        jar = http.cookiejar.CookieJar()
        self._opener = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(jar))

    def get(self, path: str, form: dict[str, str] | None = None) -> tuple[int, str]:
        """Status and text of a page; with a form, the page that answers it."""
        data = None if form is None else urllib.parse.urlencode(form).encode()
        url = urllib.parse.urljoin(self._address, path)
        request = urllib.request.Request(url, data, {"Referer": url})
        try:
            with self._opener.open(request, timeout=60) as answer:
                return answer.status, answer.read().decode("utf-8", "replace")
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode("utf-8", "replace")

    def log_in(self, name: str, password: str) -> None:
        """Log in by the page, as people do."""
        token = _TOKEN.search(self.get("account/login/")[1])
        if token is None:
            raise DayOneError("the login page has no form")
        self.get("account/login/", {"csrfmiddlewaretoken": token[1], "login": name, "password": password})
        status, page = self.get("")
        if status != 200 or "csrfmiddlewaretoken" not in page or 'name="password"' in page:
            raise DayOneError(f"{name} is not logged in: status {status}")


class Clinic:
    """A demo clinic that a command makes and serves, in a process group of its own."""

    def __init__(self, command: list[str]) -> None:
        self.passwords: dict[str, str] = {}
        self.address = ""
        self.output = ""
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
            start_new_session=True,
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as lines:
            for line in lines:
                self.output += line
                if match := _PASSWORD.search(line):
                    self.passwords[match[1]] = match[2]
                if match := _ADDRESS.search(line):
                    self.address = match[1]

    def until_served(self) -> None:
        """Wait until the first page answers."""
        until = time.monotonic() + _MADE_S
        while time.monotonic() < until:
            if self._process.poll() is not None:
                raise DayOneError(f"the command ended with exit code {self._process.returncode}")
            if self.address:
                try:
                    if Browser(self.address).get("alive/")[0] == 200:
                        return
                except OSError:
                    pass
            time.sleep(0.2)
        raise DayOneError(f"no page after {_MADE_S} s")

    def stop(self) -> None:
        """Press Ctrl-C. What does not end in time is killed and an error."""
        try:
            os.killpg(self._process.pid, signal.SIGINT)
            self._process.wait(_STOPPED_S)
            self._reader.join(_STOPPED_S)  # children hold the pipe: it ends with the last of them
        except ProcessLookupError:
            pass
        except subprocess.TimeoutExpired:
            pass
        if self._process.poll() is None or self._reader.is_alive():
            os.killpg(self._process.pid, signal.SIGKILL)
            raise DayOneError(f"not stopped {_STOPPED_S} s after Ctrl-C")


def spend(command: list[str]) -> float:
    """Go through the first day.

    Returns:
        Seconds from the command's start until it was stopped.

    Raises:
        DayOneError: something is not as it must be.
    """
    begun = time.monotonic()
    clinic = Clinic(command)
    try:
        clinic.until_served()
        if set(clinic.passwords) != set(_OWN_PAGES):
            raise DayOneError(f"passwords were printed for {sorted(clinic.passwords)} only")
        people = {}
        for role, path in _OWN_PAGES.items():
            people[role] = Browser(clinic.address)
            people[role].log_in(role, clinic.passwords[role])
            if (status := people[role].get(path)[0]) != 200:
                raise DayOneError(f"{path} answers the {role} with status {status}")
        _wait_for_a_report(people["clinician"])
    except BaseException:
        sys.stderr.write(f"{clinic.output}\n")
        raise
    finally:
        clinic.stop()
    return time.monotonic() - begun


def _wait_for_a_report(clinician: Browser) -> None:
    patients = set(re.findall(r"/patients/([0-9a-f-]{36})/", clinician.get("patients/")[1]))
    visits = {
        visit
        for patient in patients
        for visit in re.findall(r"/visits/([0-9a-f-]{36})/", clinician.get(f"patients/{patient}/")[1])
    }
    if len(visits) < 6:
        raise DayOneError(f"{len(visits)} visits, expected six")
    until = time.monotonic() + _MEASURED_S
    while time.monotonic() < until:
        for visit in visits:
            status, page = clinician.get(f"visits/{visit}/report/")
            if status == 200 and re.search(r"\d cc", page):
                return
        time.sleep(2)
    raise DayOneError(f"no visit was measured within {_MEASURED_S} s")


def main() -> int:
    """Run the command of the arguments."""
    try:
        seconds = spend(sys.argv[1:])
    except DayOneError as error:
        sys.stderr.write(f"{' '.join(sys.argv[1:])}: {error}\n")
        return 1
    sys.stdout.write(f"{' '.join(sys.argv[1:])}: each role logged in, a visit measured, stopped; {seconds:.0f} s\n")
    return 0


if __name__ == "__main__":
    assert Path("Makefile").is_file(), "call it in the repository's folder"
    sys.exit(main())
