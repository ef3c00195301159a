"""Resumable uploads. A photograph is sent in pieces, each appended to the previous one.

The length of the file in ``uploads/`` shows what has been received, so nothing is sent twice after a lost connection, a
restart or a kill. The complete file is compared with the sender's digest, checked, and then moved into the session in
one step: a session never contains a partial or refused photograph.
"""

import threading
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from django.db import transaction
from django.utils import timezone
from filelock import FileLock, Timeout

from mammometry.capture import camera_checks
from mammometry.capture.checks import Finding, refuses
from mammometry.capture.sessions import cameras_of, make_session, manifest_text
from mammometry.clinic.intake import photographs, walks
from mammometry.clinic.intake.announced import Announced, check_announced
from mammometry.clinic.intake.check_photographs import known_photograph
from mammometry.clinic.intake.photographs import (
    clear_place,
    files_of,
    known_cameras,
    look,
    poses_needed,
    put_back,
    set_aside,
    thumbnail_path,
)
from mammometry.clinic.intake.places import (
    Target,
    UploadError,
    field_of,
    folder_of,
    place_of,
    pose_of,
    require_open,
    rig_of,
    target_of,
    uploads_of,
)
from mammometry.clinic.intake.reassign import reassign
from mammometry.clinic.intake.walk_video import is_of_video
from mammometry.clinic.models import Calibration, DailyCheck, Job, Person, Upload, Visit
from mammometry.clinic.site import the_clinic
from mammometry.io.write import disk_errors, file_digest, sync_folder

CHUNK_BYTES = 4 << 20
"""Largest piece: one second on a slow line, and small enough to hold in memory."""
_ENDINGS = {b"\xff\xd8\xff": ".jpg", b"\x89PNG": ".png", b"II*\x00": ".tif", b"MM\x00*": ".tif"}
_LOCK_S = 5.0  # time that a piece waits for another piece of the same photograph
_DECODED_AT_ONCE = threading.BoundedSemaphore(2)  # checking a photograph of 250 megapixels takes 750 MB


class OccupiedError(UploadError):
    """There is another photograph of this camera, and replacing it was not allowed."""

    code = "place-occupied"


def begin(target: Target, by: Person | None, file: Announced, *, replace: bool = False) -> Upload:
    """Start an upload, or find an interrupted one.

    Args:
        target: visit, calibration or check.
        by: the sender.
        file: the announcement.
        replace: whether it replaces another photograph, which is set aside.

    Raises:
        OccupiedError: there is another photograph of this camera.
        UploadError: the file is too large, its camera unknown, or the visit is being measured.
    """
    if walks.is_walk(target):
        return walks.begin(target, by, file)
    require_open(target)
    camera, pose, size_bytes, sha256 = file.camera, file.pose, file.size_bytes, file.sha256
    known = cameras_of(rig_of(target).definition)
    if camera is not None and camera not in known:
        raise UploadError(f"This rig has no camera {camera[:40]!r}, only {', '.join(known)}.", 400)
    check_announced(file)
    named = camera_checks.camera_of_name(file.name, known)
    place = place_of(target, pose, camera or named or "")
    of_pose = pose if isinstance(target, Calibration) else ""
    if sha256:
        gone = (Upload.State.REFUSED, Upload.State.SET_ASIDE)
        same = uploads_of(target).filter(camera=camera or named or "", sha256=sha256).exclude(state__in=gone)
        if (earlier := next((row for row in same if pose_of(row) == of_pose), None)) is not None:
            return earlier
    if not replace and (camera or named) and _has_photograph(target, pose, camera or named or ""):
        raise OccupiedError(
            f"{f'Pose {pose}' if of_pose else 'This'} has another photograph of {camera or named} already."
        )
    named_by = [Finding("name", "ok", f"The file is called {named}.").as_table()] if named else []
    if not named and file.camera_file is not None:
        named_by = [{**Finding("name", "unknown", f"The file is called {file.name}.").as_table(), "file": file.name}]
    with transaction.atomic():
        upload = Upload.objects.create(
            **{field_of(target): target},
            camera=camera or named or "",
            name=place,
            size_bytes=size_bytes,
            sha256=sha256,
            checks=[{**check, "named": named} for check in named_by],
            created_by=by,
        )
        if isinstance(target, Visit) and target.state == Visit.State.NEW:
            target.state = Visit.State.UPLOADING
            target.save(update_fields=["state"])
    return upload


def _has_photograph(target: Target, pose: str, camera: str) -> bool:
    """Whether a camera has a photograph, or an upload for it is running."""
    uploads = uploads_of(target).filter(camera=camera, state__in=(Upload.State.PLACED, Upload.State.RECEIVING))
    of_pose = pose if isinstance(target, Calibration) else ""
    return any(pose_of(upload) == of_pose for upload in uploads)


def append(upload: Upload, offset: int, data: bytes) -> Upload:
    """Append a piece. After the last one, check the photograph and store it for its camera.

    Raises:
        UploadError: the piece does not start where the previous one ended, or exceeds the file's size.
        StorageError: the disk is full or refuses.
    """
    if upload.state != Upload.State.RECEIVING:
        raise UploadError("This photograph has already arrived.")
    try:
        with FileLock(f"{upload.path}.lock", timeout=_LOCK_S), disk_errors(upload.path):
            arrived_bytes = arrived(upload)
            if offset != arrived_bytes:
                raise UploadError(f"The next byte is {arrived_bytes}, not {offset}. Continue from there.")
            if arrived_bytes + len(data) > upload.size_bytes:
                raise UploadError(f"That is more than the {upload.size_bytes} bytes that were announced.", 413)
            with upload.path.open("ab") as file:
                file.write(data)
            arrived_bytes += len(data)
            Upload.objects.filter(pk=upload.pk).update(received_bytes=arrived_bytes)
            if arrived_bytes == upload.size_bytes:
                _finish(upload)
                # The upload is complete: later pieces are refused because of its state.
                Path(f"{upload.path}.lock").unlink(missing_ok=True)
    except Timeout:
        raise UploadError("Another piece of this photograph is arriving. Ask again where to continue.") from None
    upload.refresh_from_db()
    return upload


def arrived(upload: Upload) -> int:
    """Number of stored bytes, at which the next piece starts."""
    if upload.state != Upload.State.RECEIVING:
        return upload.size_bytes
    return upload.path.stat().st_size if upload.path.exists() else 0


def resumed(upload: Upload) -> Upload:
    """State of an upload. If the server was killed after the last byte, the upload is completed now."""
    if upload.state == Upload.State.RECEIVING and arrived(upload) == upload.size_bytes:
        return append(upload, upload.size_bytes, b"")
    return upload


def place(upload: Upload, camera: str) -> Upload:
    """Choose or change a photograph's camera by hand.

    If this camera already has a photograph, the two photographs swap cameras.

    Raises:
        UploadError: the photograph has not arrived, the rig has no such camera, or the photograph cannot be from it.
        StorageError: the disk is full or refuses.
    """
    target = target_of(upload)
    require_open(target)
    if upload.state not in (Upload.State.CHECKED, Upload.State.PLACED):
        raise UploadError("This photograph is not here, or has not arrived.")
    if camera not in cameras_of(rig_of(target).definition):
        raise UploadError(f"This rig has no camera {camera[:40]!r}.", 400)
    if upload.state == Upload.State.PLACED:
        if camera != upload.camera:
            taken = _has_photograph(target, pose_of(upload), camera)
            back = {upload.camera: camera} if taken else {}
            reassign(target, {camera: upload.camera, **back}, "Its camera was chosen by hand.", pose_of(upload))
            note_ready(target, changed=True)
    else:
        upload.camera, upload.name = camera, place_of(target, pose_of(upload), camera)
        _judge_and_place(upload)
    upload.refresh_from_db()
    return upload


def put_right(visit: Visit, exchanged: Mapping[str, str]) -> None:
    """Assign swapped photographs to the right cameras, as found by comparison with the calibration.

    Args:
        visit: visit with the photographs.
        exchanged: camera → camera under which its photograph is stored, as shown on the page.

    Raises:
        UploadError: the visit is being measured, or other photographs are swapped now.
        StorageError: the disk is full or refuses.
    """
    require_open(visit)
    if not exchanged or dict(exchanged) != _exchanged(visit):
        raise UploadError("The photographs were changed meanwhile. Load the page again.")
    reassign(visit, exchanged, "By the calibration, this camera took it.")
    note_ready(visit, changed=True)


def remove(upload: Upload) -> None:
    """Set a photograph aside, or delete an incomplete upload.

    Raises:
        UploadError: the visit is being measured, or the photograph is already set aside.
        StorageError: the disk is full or refuses.
    """
    target = target_of(upload)
    require_open(target)
    if upload.state == Upload.State.SET_ASIDE:
        raise UploadError("This photograph is set aside already.")
    if walks.is_walk(target) and walks.is_prepared(target):
        raise UploadError(walks.PREPARED)
    if upload.state == Upload.State.PLACED and not walks.is_walk(target):
        with transaction.atomic():
            set_aside(upload, folder_of(target))
            note_ready(target, changed=True)
        return
    for path in files_of(upload):
        path.unlink(missing_ok=True)
    upload.delete()
    note_ready(target)


def bring_back(upload: Upload) -> None:
    """Restore a photograph that was set aside. The one that replaced it is set aside.

    Raises:
        UploadError: the photograph is not set aside, or the visit is being measured.
        StorageError: the disk is full or refuses.
    """
    target = target_of(upload)
    require_open(target)
    if upload.state != Upload.State.SET_ASIDE:
        raise UploadError("This photograph is not set aside.")
    folder = folder_of(target)
    name = f"{place_of(target, pose_of(upload), upload.camera)}{Path(upload.name).suffix}"
    with transaction.atomic():
        _clear_place(upload, target, folder / name)
        put_back(upload, folder, folder / name)
        upload.name, upload.state, upload.created = name, Upload.State.PLACED, timezone.now()
        upload.save()
        note_ready(target, changed=True)


def table_of(upload: Upload) -> dict[str, Any]:
    """An upload as JSON, without addresses."""
    field = "visit" if upload.visit_id else "calibration" if upload.calibration_id else "check"
    return {
        "id": str(upload.pk),
        "for": field,
        "camera": upload.camera or None,
        "pose": pose_of(upload) or None,
        "name": Path(upload.name).stem if upload.camera else None,
        "size_bytes": upload.size_bytes,
        "offset": arrived(upload),
        "chunk_bytes": CHUNK_BYTES,
        "state": upload.state,
        "checks": [{name: check[name] for name in ("check", "ok", "level", "sentence")} for check in upload.checks],
        "has_thumbnail": thumbnail_path(upload).is_file(),
        "is_video": is_of_video(upload),
        "file": _facts(upload)[1].get("file"),
        "by_hand": upload.state == Upload.State.PLACED and not _facts(upload)[1].get("serial"),
    }


def _shot(upload: Upload, beside_others: Finding | None) -> dict[str, Any]:
    """A telephone's photograph or video as JSON, with the reason if it will be left out."""
    table = {**table_of(upload), "by_hand": False}
    return table if beside_others is None else {**table, "checks": [*table["checks"], beside_others.as_table()]}


def state_of(target: Target) -> dict[str, Any]:
    """Every camera's photograph, including missing ones, and findings about all of them together."""
    if walks.is_walk(target):
        out = walks.findings_together(target)
        shots = [_shot(upload, out.get(upload.pk)) for upload in walks.photographs_of(target)]
        return {**walks.state_of(target, out), "shots": shots, "unplaced": [], "set_aside": [], "missing": []}
    uploads = list(uploads_of(target).exclude(state=Upload.State.SET_ASIDE))
    newest = {(pose_of(upload), upload.camera): upload for upload in uploads if upload.camera}
    placed = {shot: upload for shot, upload in newest.items() if upload.state == Upload.State.PLACED}
    known = cameras_of(rig_of(target).definition)
    common: dict[str, Any] = {
        "unplaced": [table_of(upload) for upload in uploads if not upload.camera],
        "set_aside": [
            table_of(upload) for upload in uploads_of(target).filter(state=Upload.State.SET_ASIDE).order_by("camera")
        ],
        "busy": Job.objects.filter(**{field_of(target): target}, state__in=Job.OPEN).exists(),
    }
    if isinstance(target, Calibration):
        poses = sorted({pose for pose, _ in newest})
        shown = {
            pose: {camera: table_of(newest[pose, camera]) for camera in known if (pose, camera) in newest}
            for pose in poses
        }
        missing = [camera for camera in known if camera not in {name for _, name in placed}]
        needed = poses_needed(rig_of(target).definition, known, placed)
        return {
            "poses": shown, "missing": missing, "needed": needed, "ready": bool(known) and not needed,
            "together": [], "known": known, **common,
        }  # fmt: skip
    missing = [camera for camera in known if ("", camera) not in placed]
    rows = [
        {"camera": camera, "upload": table_of(newest["", camera]) if ("", camera) in newest else None}
        for camera in known
    ]
    together = _together(target, [upload for upload in placed.values()])
    most = 0 if isinstance(target, Visit) else len(known) - 2  # a check needs two cameras that see the board
    ready = bool(known) and len(missing) <= most and not refuses(together)
    return {
        "cameras": rows,
        "missing": missing,
        "together": [finding.as_table() for finding in together],
        "exchanged": _exchanged(target) if isinstance(target, Visit) and refuses(together) else {},
        "by_geometry": _by_geometry(target, placed.values(), missing) if isinstance(target, Visit) else {},
        "ready": ready,
        **common,
    }


# --- for a complete photograph ---


def _finish(upload: Upload) -> None:
    digest = file_digest(upload.path)
    if upload.sha256 and digest != upload.sha256:
        sentence = "The photograph was damaged during the upload. Send it again."
        _refuse(upload, [Finding("digest", "refuse", sentence)])
        return
    upload.sha256 = digest
    upload.received_bytes = upload.size_bytes
    _judge_and_place(upload)


def _judge_and_place(upload: Upload) -> None:
    target = target_of(upload)
    with _DECODED_AT_ONCE:
        by_serial = not upload.camera
        findings, seen = walks.look(upload) if walks.is_walk(target) else look(upload, target)
    if refuses(findings):
        _refuse(upload, findings)
        return
    if walks.is_walk(target):
        upload.checks, upload.state = [{**finding.as_table(), **seen} for finding in findings], Upload.State.PLACED
        upload.save()
        note_ready(target)
        return
    if by_serial and upload.camera and _has_photograph(target, pose_of(upload), upload.camera):
        sentence = f"Its serial number is that of {upload.camera}, which has another photograph. Choose the camera."
        findings.append(Finding("camera", "warn", sentence))
        upload.camera = ""
    upload.checks = [{**finding.as_table(), **seen} for finding in findings]
    upload.state = Upload.State.PLACED if upload.camera else Upload.State.CHECKED
    if not upload.camera:
        upload.save()
        return
    folder = folder_of(target)
    with upload.path.open("rb") as file:
        head = file.read(4)
    ending = next(ending for mark, ending in _ENDINGS.items() if head.startswith(mark))
    goal = folder / f"{place_of(target, pose_of(upload), upload.camera)}{ending}"
    if isinstance(target, Visit):
        ready_folder(target)
    with transaction.atomic():
        # One photograph of a target at a time, so that file and row agree. SQLite allows only one writer anyway.
        type(target)._default_manager.select_for_update().get(pk=target.pk)
        changed = _clear_place(upload, target, goal)
        with disk_errors(goal):
            goal.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            upload.path.replace(goal)  # from here on, it is in the session; the row follows
            sync_folder(goal.parent)
        upload.name = goal.relative_to(folder).as_posix()
        upload.save()
        note_ready(target, changed=changed)


def _clear_place(upload: Upload, target: Target, goal: Path) -> bool:
    others = uploads_of(target).filter(camera=upload.camera).exclude(pk=upload.pk)
    left = (Upload.State.RECEIVING, Upload.State.SET_ASIDE)
    same_pose = [other for other in others.exclude(state__in=left) if pose_of(other) == pose_of(upload)]
    return clear_place(same_pose, upload, folder_of(target), goal)


def ready_folder(visit: Visit) -> None:
    """Make a visit's session folder, whose manifest names the patient by pseudonym.

    SessionError: the rig's description is invalid.
        SessionError: the rig's definition is not one.
        StorageError: the disk is full or refuses.
    """
    text = manifest_text(
        rig_of(visit).definition, visit.subject_kind, visit.patient.pseudonym, timezone.localdate(visit.taken_at),
        posture="unknown" if visit.subject_kind == Visit.Subject.TORSO else None,  # only the database knows it
    )  # fmt: skip
    make_session(visit.folder, text)


def _together(target: Target, placed: Sequence[Upload]) -> list[Finding]:
    if len(placed) < 2:
        return []
    facts = dict(map(_facts, placed))
    taken = {camera: table["taken_s"] for camera, table in facts.items() if table.get("taken_s") is not None}
    known = known_cameras(target)
    clock_s = {camera: about.clock_s for camera, about in known.items() if about.clock_s is not None}
    same = {camera: table.get("pixels") or upload.sha256 for upload in placed for camera, table in [_facts(upload)]}
    findings = [camera_checks.together(taken, clock_s), *camera_checks.twice(same)]
    if isinstance(target, Visit) and not refuses(findings):
        findings += photographs.check(target, _shots(target, placed)).findings
    if isinstance(target, DailyCheck) and not target.figures:  # another check may have been evaluated since
        for upload in placed:
            _, table = _facts(upload)
            findings += known_photograph(upload, target, table.get("pixels", ""), table.get("taken_s"))
    return findings


def _shots(visit: Visit, placed: Iterable[Upload]) -> photographs.Placed:
    return tuple((upload.camera, upload.sha256, visit.folder / upload.name) for upload in placed)


def _exchanged(visit: Visit) -> dict[str, str]:
    """Camera → camera under which its photograph is stored, by comparison with the calibration."""
    placed = uploads_of(visit).filter(state=Upload.State.PLACED)
    newest = {upload.camera: upload for upload in placed if upload.camera}
    return dict(photographs.check(visit, _shots(visit, newest.values())).exchanged)


def _by_geometry(visit: Visit, placed: Iterable[Upload], missing: Sequence[str]) -> dict[str, str]:
    """Upload without a camera → its camera, from the calibration. Empty if any cannot be determined."""
    unnamed = list(uploads_of(visit).filter(state=Upload.State.CHECKED, camera=""))
    if len(unnamed) != len(missing):
        return {}
    shots = tuple((camera, row.sha256, row.path) for camera, row in zip(missing, unnamed, strict=True))
    cameras = photographs.cameras_by_geometry(visit, _shots(visit, placed), shots)
    return {str(row.pk): cameras[row.sha256] for row in unnamed if row.sha256 in cameras}


def _facts(upload: Upload) -> tuple[str, dict[str, Any]]:
    """A photograph's camera, and the stored data about its file."""
    return upload.camera, upload.checks[0] if upload.checks else {}


def _refuse(upload: Upload, findings: Sequence[Finding]) -> None:
    upload.checks = [finding.as_table() for finding in findings]
    upload.state = Upload.State.REFUSED
    upload.path.unlink(missing_ok=True)
    upload.save()


def note_ready(target: Target, *, changed: bool = False) -> None:
    """Update a visit's state after a change of its photographs."""
    if not isinstance(target, Visit):
        return
    if target.measurements.exists():
        state = Visit.State.CHANGED if changed else Visit.State(target.state)
    else:
        state = Visit.State.READY if state_of(target)["ready"] else Visit.State.UPLOADING
    if target.state != state:
        target.state = state
        target.save(update_fields=["state"])


def remove_stale_locks() -> int:
    """Remove lock files of inactive uploads. Return their number."""
    receiving = {str(key) for key in Upload.objects.filter(state=Upload.State.RECEIVING).values_list("pk", flat=True)}
    stale = [path for path in (the_clinic().folder / "uploads").glob("*.lock") if path.stem not in receiving]
    for path in stale:
        path.unlink(missing_ok=True)
    return len(stale)
