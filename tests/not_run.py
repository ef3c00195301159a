"""What did not run: ``--all-must-run`` names tests that were not reached, and fails where one was skipped in vain."""

from collections.abc import Iterable, Sequence

import pytest

MAY_SKIP = (
    "third-party captures are not beside",
    "the clinic was tested with SQLite alone",  # a slow test runs all of it with PostgreSQL
    "this is that run",
    "not a git checkout",
    "SQLite has no TRUNCATE",
    "mounting",  # needs rights that containers lack; the same is tested with injected errors
    "this gphoto2 has no simulated camera",
)
"""Beginnings of the reasons for which a test may be skipped although all is installed that .ci/run installs."""


def not_run(skipped: Iterable[tuple[str, str]]) -> list[str]:
    """Tests that were skipped for another reason, with it, from names and reasons."""
    return [
        f"{name}: {reason}" for name, reason in skipped if not reason.removeprefix("Skipped: ").startswith(MAY_SKIP)
    ]


class NotRun:
    """Lets a run fail in which a test was skipped that should have run: else it would never run anywhere."""

    def __init__(self) -> None:
        self._chosen: dict[str, None] = {}  # in their order
        self._reached: set[str] = set()

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        self._chosen |= dict.fromkeys(item.nodeid for item in session.items)

    @pytest.hookimpl(optionalhook=True)
    def pytest_xdist_node_collection_finished(self, ids: Sequence[str]) -> None:
        self._chosen |= dict.fromkeys(ids)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "teardown":
            self._reached.add(report.nodeid)

    @pytest.hookimpl(tryfirst=True)  # before the terminal's own, which shows what was set here
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        reporter = session.config.pluginmanager.get_plugin("terminalreporter")
        if reporter is None or hasattr(session.config, "workerinput"):
            return
        reports = [report for report in reporter.stats.get("skipped", ()) if isinstance(report.longrepr, tuple)]
        reporter.write("\n")
        for name in self._chosen:
            if name not in self._reached:
                reporter.write_line(f"not reached: {name}")
        for line in not_run((report.nodeid, report.longrepr[2]) for report in reports):
            reporter.write_line(f"ERROR not run: {line}", red=True)
            session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED
