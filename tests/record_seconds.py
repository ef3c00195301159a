"""How long tests take: CPU seconds, with those of the processes that they start, for ``seconds.txt``.

CPU seconds say the same on a loaded machine as on a quiet one. What a shared fixture takes counts for the test that
asked for it first.
"""

import resource
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path

import pytest
from tests.rota import function_of, recorded

LONG_FILE_S, LONG_TEST_S = 4.0, 0.5
"""Shorter files of the default run, and shorter slow tests, are not worth a line."""
LONG_DEFAULT_S = 0.7
"""Longer tests of the default run are listed: 290 s for all of them are 0.06 s each (decision 35)."""
_PROPERTY = "cpu seconds"


def _cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


class Recorder:
    """Measures where tests run, and writes where they are reported."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._cases: dict[str, list[float]] = defaultdict(list)
        self._slow: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, object, object]:
        self._last = _cpu_s()
        return (yield)

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_makereport(self, item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        now = _cpu_s()
        slow = item.get_closest_marker("slow") is not None
        report.user_properties = [(_PROPERTY, (now - self._last, slow))]  # of this phase only
        self._last = now
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        for name, (seconds, slow) in report.user_properties:
            assert name == _PROPERTY
            if report.when == "setup":
                self._cases[report.nodeid].append(0.0)
            self._cases[report.nodeid][-1] += seconds
            if slow:
                self._slow.add(report.nodeid)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        took = {test: seconds[0] for test, seconds in self._cases.items() if test not in self._slow}
        long = sorted((test for test in took if took[test] >= LONG_DEFAULT_S), key=lambda test: -took[test])
        terminalreporter.section(
            f"default tests: {sum(took.values()):.0f} s, {len(long)} of {LONG_DEFAULT_S} s and more"
        )
        for test in long:
            terminalreporter.write_line(f"{took[test]:7.1f} {test}: make it cheaper, or mark it slow")

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        if hasattr(session.config, "workerinput"):
            return
        found, of_function = dict[str, float](), defaultdict[str, list[float]](list)
        for test, (seconds, *_) in self._cases.items():
            file = test.partition("::")[0]
            if test in self._slow:
                of_function[function_of(test)].append(seconds)
            else:
                found[file] = found.get(file, 0.0) + seconds
        found = {name: seconds for name, seconds in found.items() if seconds >= LONG_FILE_S}
        means = {name: sum(each) / len(each) for name, each in of_function.items()}
        found |= {name: seconds for name, seconds in means.items() if seconds >= LONG_TEST_S}
        seen = {test.partition("::")[0] for test in self._cases if test not in self._slow}
        earlier = recorded(self._path)
        kept = {name: seconds for name, seconds in earlier.items() if name not in {*seen, *of_function}}
        # A file that waits takes few CPU seconds.
        kept |= {name: seconds for name, seconds in earlier.items() if name in seen - {*found} and seconds.is_integer()}
        words = [line for line in self._path.read_text(encoding="utf-8").splitlines() if line.startswith("#")]
        lines = sorted((kept | found).items(), key=lambda entry: ("::" in entry[0], -entry[1], entry[0]))
        self._path.write_text("\n".join([*words, *(f"{seconds:7.1f} {name}" for name, seconds in lines), ""]))
