"""The runner takes jobs from the queue and runs them.

Computations run on Dask workers, other jobs in threads of this process.
"""

import json
import logging
import threading
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager
from uuid import UUID

from django.db import DatabaseError, close_old_connections, connections

from mammometry.base.child_process import Call
from mammometry.base.errors import BusyError, MammometryError
from mammometry.batch.cluster import Machines, machines
from mammometry.batch.engine import Began, Ended, Engine, StopRequest, Task
from mammometry.batch.record import RECORD, read_record
from mammometry.clinic.config import ClinicConfig
from mammometry.clinic.intake.walks import job_files
from mammometry.clinic.jobs import queue, work
from mammometry.clinic.jobs.lanes import Lane
from mammometry.clinic.models import Job, Visit
from mammometry.clinic.records.comparing import comparison_folder

_LOOK_S = 1.0  # time between two checks of an empty queue
_LANE_LOOK_S = 5.0  # time between two checks for jobs of a lane, and for scheduled ones
_AGAIN_S = 5.0  # time until the next attempt to reach the cluster
_LOOKED_BACK = 40  # number of newest visits from which a job's memory is estimated
_SHARES = {"prepare": 0.02, "calibrate": 0.05, "match": 0.3, "surface": 0.7, "measure": 0.92, "report": 1.0}
"""Stage → approximate share of the total time at its end."""
# stage of a walk in which the board is found, and its approximate share of the time
_BOARD, _BOARD_SHARE = "board", 0.2
_LOG = logging.getLogger(__name__)

Workers = Callable[[], AbstractContextManager[Machines]]


class Runner:
    """Runs the queue's jobs until it is stopped.

    Args:
        config: the clinic's, with Django set up.
        workers: connects to a cluster, or starts one; None: according to the clinic's settings.
        lanes: jobs that run in this process.
    """

    def __init__(self, config: ClinicConfig, workers: Workers | None = None, lanes: Sequence[Lane] = ()) -> None:
        self.owner = queue.new_owner()
        self._config = config
        self._workers = workers or (lambda: machines(config.cluster or None))
        self._lanes = lanes
        self._stopped = threading.Event()

    def stop(self) -> None:
        """Stop running jobs, queue them again, and end."""
        self._stopped.set()

    def run(self) -> None:
        """Run jobs until stopped. Waits while the cluster is unavailable."""
        heart = threading.Thread(target=self._beat, daemon=True)
        heart.start()
        for lane in self._lanes:
            threading.Thread(target=self._serve_lane, args=(lane,), daemon=True, name=lane.name).start()
        while not self._stopped.is_set():
            try:
                queue.requeue_abandoned()
                if not queue.anything():  # workers are started only if there is work
                    self._stopped.wait(_LOOK_S)
                    continue
                with self._workers() as workers:
                    self._serve(workers)
            except (MammometryError, DatabaseError, OSError) as error:
                _LOG.warning("The queue waits: %s", type(error).__name__ if isinstance(error, DatabaseError) else error)
                close_old_connections()
                self._stopped.wait(_AGAIN_S)
            finally:
                self._give_back(queue.COMPUTED)
        heart.join()
        self._give_back(tuple(Job.Kind))  # a running lane ends with this process

    def _give_back(self, kinds: Collection[str]) -> None:
        try:
            queue.release(self.owner, kinds=kinds)
        except DatabaseError:  # its leases expire
            close_old_connections()

    def _beat(self) -> None:
        """Renew the leases, and queue the jobs of dead runners again."""
        while not self._stopped.wait(queue.LEASE_S / 3):
            try:
                queue.renew(self.owner)
                queue.requeue_abandoned()
            except DatabaseError:
                close_old_connections()
        connections.close_all()  # those of this thread

    def _serve_lane(self, lane: Lane) -> None:
        """Run a lane's jobs. Waits while the database or the disk is unavailable."""
        while not self._stopped.is_set():
            try:
                queue.abandon(self.owner, lane.work)
                if jobs := queue.claim(self.owner, 1, lane.work):
                    self._do(jobs[0], lane)
                    continue
                lane.plan(self._config)
            except (MammometryError, DatabaseError, OSError) as error:
                _LOG.warning("The %s wait: %s", lane.name, type(error).__name__)
            except Exception:
                _LOG.exception("The %s wait", lane.name)
            close_old_connections()
            self._stopped.wait(_LANE_LOOK_S)
        connections.close_all()  # those of this thread

    def _do(self, job: Job, lane: Lane) -> None:
        try:
            answer = lane.work[job.kind](self._config, job)
        except MammometryError as error:
            queue.failed(job.pk, self.owner, _words(error, self._config), error.exit_code)
        except Exception as error:  # from a library or the operating system
            _LOG.exception("A job failed: %s", job)
            why = f"An unknown reason ({type(error).__name__}), which is in the clinic's log."
            queue.failed(job.pk, self.owner, why, 1)
        else:
            queue.done(job.pk, self.owner, answer)

    def _serve(self, workers: Machines) -> None:
        engine = Engine(workers, known=self._known(), stop=self._stop_request)
        for event in engine.serve(self._claim, lambda: queue.unwanted(self.owner)):
            key = UUID(event.name)
            if isinstance(event, Began):
                queue.progressed(key, self.owner, event.stage, whole(event.stage, event.fraction))
            else:
                self._end(key, event)

    def _stop_request(self) -> StopRequest:
        return StopRequest.STOP if self._stopped.is_set() else StopRequest.NONE

    def _claim(self, room: int) -> Sequence[Task]:
        return [self._task(job) for job in queue.claim(self.owner, room)]

    def _end(self, key: UUID, event: Ended) -> None:
        if not event.failed:
            held = queue.done(key, self.owner, event.value)
        elif event.code == BusyError.code:  # a former process of this clinic is still using the session
            queue.release(self.owner, key)
            return
        else:
            held = queue.failed(key, self.owner, _words(event.failed, self._config), event.exit_code)
        if not held:
            _LOG.info("Job %s is no longer ours; its results remain on the disk.", key)

    def _task(self, job: Job) -> Task:
        folder, settings = self._config.folder, self._settings()
        function: Callable[..., object]
        arguments: tuple[str, ...]
        if job.visit is not None and job.visit.is_scan:
            function, arguments = work.measure_scan, (str(job.visit.folder),)
        elif job.visit is not None and job.visit.is_walk:
            function, arguments = work.measure_walk, (str(job.visit.folder), json.dumps(job_files(job.visit)))
        elif job.visit is not None:
            assert job.visit.calibration is not None
            function, arguments = work.measure, (str(job.visit.folder), str(folder / job.visit.calibration.folder))
        elif job.calibration is not None:
            function, arguments = work.calibrate, (str(folder / job.calibration.folder),)
        elif job.comparison is not None:
            before, after = job.comparison.before, job.comparison.after
            kept = str(comparison_folder(before, after))
            function, arguments = work.compare, (str(before.folder), str(after.folder), kept, job.comparison.of)
        else:
            check = job.check_of_day
            assert check is not None
            assert check.calibration is not None
            function, arguments = work.check, (str(folder / check.calibration.folder), str(folder / check.folder))
        size = _megapixels(job.visit) if job.visit is not None and job.visit.rig_id is not None else None
        return Task(name=str(job.pk), call=Call(function=function, arguments=(*arguments, settings)), megapixels=size)

    def _settings(self) -> str:
        return self._config.measuring().to_toml()

    def _known(self) -> list[tuple[float, float]]:
        """Memory used by the newest visits."""
        known = []
        for visit in Visit.objects.filter(measurements__isnull=False).distinct()[:_LOOKED_BACK]:
            try:
                record = read_record((visit.folder / "results" / RECORD).read_bytes())
            except OSError:
                continue
            if record is not None and record.row.peak_memory_mb:
                known.append((record.row.megapixels, record.row.peak_memory_mb))
        return known


def _words(reason: object, config: ClinicConfig) -> str:
    """A reason without paths on this machine."""
    return str(reason).replace(f"{config.folder}/", "")


def whole(stage: str, fraction: float) -> float:
    """Share of a complete measurement, from the fraction of a stage."""
    if stage == _BOARD:
        return _BOARD_SHARE * min(max(fraction, 0.0), 1.0)
    names = list(_SHARES)
    if stage not in _SHARES:
        return fraction if stage in ("check", "compare") else 0.0
    before = 0.0 if stage == names[0] else _SHARES[names[names.index(stage) - 1]]
    return before + (_SHARES[stage] - before) * min(max(fraction, 0.0), 1.0)


def _megapixels(visit: Visit) -> float | None:
    from mammometry.io.photographs.images import megapixels_of

    try:
        return megapixels_of(visit.folder / "capture")
    except (OSError, MammometryError):  # its own job will report the fault
        return None
