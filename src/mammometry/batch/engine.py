"""Tasks on Dask's workers, retried when a worker dies.

Nothing of a scheduler is ours: every task is given to Dask at once, with the cores and the memory that it needs, and
Dask finds the worker that has them free. What is ours is what becomes of a task that took a worker down.
"""

import queue
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, TypeAlias
from uuid import uuid4

from mammometry.base.child_process import Call
from mammometry.base.errors import BatchError
from mammometry.batch import record
from mammometry.batch.cluster import Machines, other_version
from mammometry.batch.record import CORES, MEMORY, software
from mammometry.batch.supervise import TOPIC, ProcessLimits, stop, stop_all, supervise

_KIND = "mammometry"  # first word of all keys: Dask learns by it how long tasks take, and spreads them evenly
_DEATHS = 2  # of a task before it fails; the last one alone on its worker
_WAIT_S = 15.0  # for a worker to report its resources
_REPORTS_A_SECOND = 20  # of progress from all workers together; starts of stages come in addition
_LOOK_S = 0.25  # between two checks of the user's request


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A call for a worker, with its requirements."""

    name: str
    """Of its own in the batch."""
    call: Call
    megapixels: float | None = None
    """Size of the photographs, on which the memory depends. None if unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Began:
    """Progress of a running task."""

    name: str
    stage: str
    fraction: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Ended:
    """Outcome of a task."""

    name: str
    value: Any = None
    """Result of its function."""
    failed: str = ""
    """Reason for having no value, one sentence."""
    kind: str = ""
    """Class of the error. ``Killed`` if its process or worker died twice."""
    code: str = ""
    """Code of the error (`MammometryError.code`). Empty for any other error."""
    exit_code: int = 0
    host: str = ""
    memory_mb: float | None = None


Event: TypeAlias = Began | Ended


class StopRequest(Enum):
    """The user's request to a running batch."""

    NONE = auto()
    FINISH = auto()
    """Start no new tasks, and finish the running ones."""
    STOP = auto()
    """Also stop the running tasks."""


@dataclass(slots=True)
class _Tried:
    """State of a task: its attempts and their outcome."""

    task: Task
    alone: bool = False
    """Whether it has a worker to itself."""
    deaths: int = 0
    """How often its process or its worker died."""
    began: bool = False


class Engine:
    """Runs tasks on machines.

    Args:
        machines: the workers.
        cores: per task.
        known: (megapixels, peak memory in MB) of earlier tasks of the same kind.
        stop: returns the user's request.
    """

    def __init__(
        self,
        machines: Machines,
        *,
        cores: int = 1,
        known: Sequence[tuple[float, float]] = (),
        stop: Callable[[], StopRequest] = lambda: StopRequest.NONE,
    ) -> None:
        self._machines, self._stop_request = machines, stop
        self._known = list(known)
        self._events: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._at_work: dict[str, tuple[Any, _Tried]] = {}
        self._names: dict[str, str] = {}  # of tasks, by their keys in Dask
        self._largest_mb = 0.0
        self._limits = ProcessLimits(
            batch=uuid4().hex, cores=cores, software=software(), report_s=max(1.0, machines.count() / _REPORTS_A_SECOND)
        )

    def run(self, tasks: Iterable[Task]) -> Iterator[Event]:
        """Run all tasks to their end.

        Yield events as they happen. If no task of this kind was measured before, one goes first with a worker to
        itself: its memory shows how much the others need.

        Raises:
            BatchError: the scheduler has stopped, or a worker runs another version.
        """
        waiting = sorted(
            tasks, key=lambda task: -(task.megapixels or 0.0)
        )  # the largest first, so that all end together
        with self._connected():
            if waiting and not self._known:
                yield from self._until_done([_Tried(waiting.pop(0), alone=True)])
            yield from self._until_done([_Tried(task) for task in waiting])

    def serve(
        self, claim: Callable[[int], Iterable[Task]], unwanted: Callable[[], Collection[str]] = tuple
    ) -> Iterator[Event]:
        """Run tasks as they come, until the user stops.

        Yield events as they happen. Until a task has been measured, each has a worker to itself.

        Args:
            claim: called often, with the number of tasks that can be started now; returns tasks to run.
            unwanted: names of tasks to stop, for some seconds each. They end without an event.

        Raises:
            BatchError: the scheduler has stopped, or a worker runs another version.
        """
        with self._connected():
            while self._stop_request() is StopRequest.NONE or self._at_work:
                self._apply()
                self._stop(unwanted())
                room = max(self._machines.cores() // self._limits.cores, 1) - len(self._at_work)
                claimed = tuple(claim(room)) if room > 0 and self._stop_request() is StopRequest.NONE else ()
                if claimed:
                    self._largest_mb = self._resources()
                for task in claimed:
                    self._submit(_Tried(task, alone=not self._known))
                yield from self._next()

    @contextmanager
    def _connected(self) -> Iterator[None]:
        """Context that receives workers' reports, and drops running tasks at its end.

        Raises:
            BatchError: a request was cut off, because the scheduler has stopped.
        """
        import distributed

        client = self._machines.client
        try:
            client.subscribe_topic(TOPIC, self._hear)
            try:
                yield
            finally:
                client.unsubscribe_topic(TOPIC)
                self._drop(lambda tried: True)
        except distributed.comm.CommClosedError:
            raise _lost() from None

    def _hear(self, event: tuple[float, Mapping[str, Any]]) -> None:
        """Called in Dask's own thread."""
        about = event[1]
        if (name := self._names.get(about["task"])) is not None:
            self._events.put(Began(name=name, stage=about["stage"], fraction=about["fraction"]))

    def _until_done(self, tasks: Sequence[_Tried]) -> Iterator[Event]:
        if self._stop_request() is not StopRequest.NONE:
            return
        if tasks:
            self._largest_mb = self._resources()
        for tried in tasks:
            self._submit(tried)
        while self._at_work:
            self._apply()
            yield from self._next()

    def _next(self) -> Iterator[Event]:
        """Next event, if it comes soon."""
        try:
            item = self._events.get(timeout=_LOOK_S)
        except queue.Empty:
            self._require_scheduler()
            return
        if isinstance(item, Began):
            if item.name in self._at_work:
                self._at_work[item.name][1].began = True
                yield item
        elif (ended := self._ended(item)) is not None:
            yield ended

    def _resources(self) -> float:
        """Memory of the largest worker, MB.

        Raises:
            BatchError: no worker has enough cores for a task.
        """
        until = time.monotonic() + _WAIT_S
        while not (most := self._machines.largest()).get(MEMORY) and time.monotonic() < until:
            time.sleep(_LOOK_S)
        if most.get(CORES, 0.0) < self._limits.cores:
            raise BatchError(
                "--cores",
                found=f"{self._limits.cores} cores for each session, and workers that have {most.get(CORES, 0.0):.0f}",
                expected="no more than a worker has",
                remedy="Give each session fewer cores, or start a worker with more threads",
            )
        return most[MEMORY]

    def _submit(self, tried: _Tried) -> None:
        largest = self._largest_mb
        need = largest if tried.alone else min(largest, record.need_mb(tried.task.megapixels, self._known) or largest)
        key = f"{_KIND}-{uuid4().hex}"  # also its name there: Dask's messages cannot contain names that are not UTF-8
        self._names[key] = tried.task.name
        future = self._machines.client.submit(
            supervise,
            key,
            tried.task.call,
            self._limits,
            key=key,
            resources={CORES: self._limits.cores, MEMORY: need},
            pure=False,
        )
        self._at_work[tried.task.name] = (future, tried)
        future.add_done_callback(self._events.put)

    def _ended(self, future: Any) -> Ended | None:
        """Result of a future, or None if it is retried or was dropped."""
        name = self._names[future.key]
        if name not in self._at_work or self._at_work[name][0].key != future.key:
            return None
        tried = self._at_work.pop(name)[1]
        answer = self._answer_of(future)
        if (theirs := answer.get("other")) is not None:
            ours = f"{self._limits.software['mammometry']} ({self._limits.software['results']})"
            found = f"mammometry version {theirs['mammometry']} ({theirs['results']})"
            raise other_version(str(answer["host"]), found, ours)
        taken = answer.get("memory_mb")
        if (why := answer.get("killed")) is not None:
            if self._stop_request() is StopRequest.STOP:
                return None
            if tried.deaths < _DEATHS - 1:
                self._submit(_Tried(tried.task, alone=True, deaths=tried.deaths + 1))
                return None
            return Ended(
                name=name,
                failed=_blame(why, taken),
                kind="Killed",
                exit_code=1,
                host=answer.get("host", ""),
                memory_mb=taken,
            )
        if taken and tried.task.megapixels and "done" in answer:
            self._known.append((tried.task.megapixels, taken))
        return Ended(
            name=name,
            value=answer.get("done"),
            failed=answer.get("failed", ""),
            kind=answer.get("kind", ""),
            code=answer.get("code", ""),
            exit_code=answer.get("exit_code", 0),
            host=answer.get("host", ""),
            memory_mb=taken,
        )

    def _answer_of(self, future: Any) -> dict[str, Any]:
        """Return the worker's answer, or ``killed`` if it died before answering."""
        from distributed import KilledWorker

        try:
            answer: dict[str, Any] = future.result()
        except CancelledError:  # not by us: dropped tasks are no longer running
            raise _lost() from None
        except KilledWorker as error:
            return {"killed": f"{getattr(error, 'allowed_failures', 3) + 1} workers died with it"}
        except Exception as error:
            self._require_scheduler()
            return {"failed": f"The worker failed: {type(error).__name__}: {error}", "kind": "Worker", "exit_code": 1}
        return answer

    def _apply(self) -> None:
        stop = self._stop_request()
        if stop is StopRequest.FINISH:
            self._drop(lambda tried: not tried.began)
        elif stop is StopRequest.STOP:
            self._drop(lambda tried: True)
            self._machines.client.run(stop_all, self._limits.batch)

    def _stop(self, names: Collection[str]) -> None:
        """Stop tasks on all workers. One whose process is just starting is stopped at the next call."""
        if names:
            self._drop(lambda tried: tried.task.name in names)
            keys = tuple(key for key, name in self._names.items() if name in names)
            self._machines.client.run(stop, self._limits.batch, keys)

    def _drop(self, which: Callable[[_Tried], bool]) -> None:
        dropped = [self._at_work.pop(name)[0] for name, (_, tried) in list(self._at_work.items()) if which(tried)]
        if dropped:
            self._machines.client.cancel(dropped, force=True)

    def _require_scheduler(self) -> None:
        """Refuse to wait for a scheduler that has stopped."""
        client = self._machines.client
        if client.status not in ("running", "connecting"):
            raise _lost()


def _lost() -> BatchError:
    remedy = "Start it and its workers again, and run the same command again: finished sessions are kept"
    expected = "a scheduler that lives as long as the batch"
    return BatchError("the scheduler", found="no answer any more", expected=expected, remedy=remedy)


def _blame(why: str, taken_mb: float | None) -> str:
    held = f" when it held {taken_mb:.0f} MB of memory" if taken_mb else ""
    return (
        f"Its process died twice{held}, the second time alone on its machine: {why}. "
        "Measure it on a machine with more memory, or make its photographs smaller."
    )
