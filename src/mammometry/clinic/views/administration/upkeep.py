"""Backups and the disk."""

from __future__ import annotations

import subprocess
import sys
import threading

from django.contrib import messages
from django.http import HttpRequest, HttpResponse
from django.shortcuts import redirect, render
from django.views.decorators.http import require_POST

from mammometry.clinic.maintenance.backups import state_of
from mammometry.clinic.maintenance.disk import cached_usage
from mammometry.clinic.site import the_clinic


def backups(request: HttpRequest) -> HttpResponse:
    """Which backups there are, when the next is made, and whether a restore was tested."""
    clinic = the_clinic()
    return render(request, "clinic/backups.html", {"state": state_of(clinic), "clinic": clinic})


@require_POST
def backup_now(request: HttpRequest) -> HttpResponse:
    """Begin a backup in a process of its own."""
    return _begun(request, "backup", "A backup is being made. You may leave this page.")


@require_POST
def test_now(request: HttpRequest) -> HttpResponse:
    """Begin a restore test in a process of its own: a process opens one clinic."""
    return _begun(request, "test-restore", "The newest backup is being restored and compared. You may leave this page.")


def disk(request: HttpRequest) -> HttpResponse:
    """What the clinic's files take, and how long the rest will last."""
    return render(request, "clinic/disk.html", {"usage": cached_usage(the_clinic())})


def _begun(request: HttpRequest, command: str, sentence: str) -> HttpResponse:
    if state_of(the_clinic()).at_work:
        messages.warning(request, "A backup or a test is at work already.")
    else:
        begin_command(command)
        messages.success(request, sentence)
    return redirect("backups")


def begin_command(command: str) -> None:
    """Run a command of the clinic beside the server. Its outcome is on the page of the backups."""
    words = [sys.executable, "-m", "mammometry", "clinic", command, str(the_clinic().folder)]
    threading.Thread(
        target=subprocess.run,
        args=(words,),
        kwargs={"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL},
        daemon=True,
    ).start()
