"""Pages about the user's own account that replace those of the login library."""

from __future__ import annotations

from allauth.account.stages import LoginStageController
from allauth.account.views import password_change
from allauth.mfa.base.views import authenticate
from allauth.mfa.stages import AuthenticateStage
from allauth.mfa.utils import is_mfa_enabled
from django.http import HttpRequest, HttpResponse, HttpResponseBase
from django.shortcuts import render

from mammometry.clinic.views.responses import person_of


def enter_code(request: HttpRequest) -> HttpResponseBase:
    """Ask for the second factor's code at login.

    If the factor was reset in the meantime, the login starts again with the password. The library's page would redirect
    to the login page and back forever.
    """
    stage = LoginStageController.enter(request, AuthenticateStage.key)
    if stage is not None and not is_mfa_enabled(stage.login.user):
        ended: HttpResponse = stage.abort()
        return ended
    response: HttpResponseBase = authenticate(request)
    return response


def change_password(request: HttpRequest) -> HttpResponse:
    """Change the user's own password, unless the hospital's login manages it."""
    if not person_of(request).has_usable_password():
        about = {"title": "No password here", "sentence": "You log in with the hospital’s own login. Change it there."}
        return render(request, "clinic/refusal.html", about)
    response: HttpResponse = password_change(request)
    return response
