"""The one table of routes. Each line says who may open it: `access.route`."""

from __future__ import annotations

from allauth.account import views as account
from allauth.mfa.base import views as mfa
from allauth.mfa.recovery_codes import views as recovery
from allauth.mfa.totp import views as totp
from allauth.socialaccount import views as social
from allauth.socialaccount.providers.openid_connect import views as openid
from django.urls import URLPattern, URLResolver

from mammometry.clinic.roles import ANYONE, CARE, EVERYBODY, RIGS
from mammometry.clinic.views import home, jobs, refusals, rigwork, who
from mammometry.clinic.views.administration import people
from mammometry.clinic.views.patient import capture, uploads
from mammometry.clinic.web.access import route, set_up_route
from mammometry.clinic.web.administration_routes import ADMINISTRATION
from mammometry.clinic.web.page_routes import PAGES

ACCOUNTS = [
    route("account/login/", account.login, name="account_login", roles=ANYONE, atomic=False),
    route("account/token/", who.token, name="account-token", roles=ANYONE, audited=False),
    route("account/logout/", account.logout, name="account_logout", roles=ANYONE),
    route("account/inactive/", account.account_inactive, name="account_inactive", roles=ANYONE),
    route("account/code/", mfa.authenticate, name="mfa_authenticate", roles=ANYONE),
    route(
        r"^account/invitation/(?P<uidb36>[0-9A-Za-z]+)-(?P<key>.+)/$",
        account.password_reset_from_key,
        name="account_reset_password_from_key",
        roles=ANYONE,
    ),
    route(
        "account/invitation/done/",
        account.password_reset_from_key_done,
        name="account_reset_password_from_key_done",
        roles=ANYONE,
    ),
    route("account/password/", people.own_password, name="account_change_password", roles=EVERYBODY),
    set_up_route("account/again/", account.reauthenticate, name="account_reauthenticate", roles=EVERYBODY),
    set_up_route("account/again/code/", mfa.reauthenticate, name="mfa_reauthenticate", roles=EVERYBODY),
    set_up_route("account/second/", mfa.index, name="mfa_index", roles=EVERYBODY),
    set_up_route("account/second/set-up/", totp.activate_totp, name="mfa_activate_totp", roles=EVERYBODY),
    route("account/second/remove/", totp.deactivate_totp, name="mfa_deactivate_totp", roles=EVERYBODY),
    route("account/second/codes/", recovery.view_recovery_codes, name="mfa_view_recovery_codes", roles=EVERYBODY),
    route(
        "account/second/codes/new/",
        recovery.generate_recovery_codes,
        name="mfa_generate_recovery_codes",
        roles=EVERYBODY,
    ),
    route(
        "account/second/codes/file/",
        recovery.download_recovery_codes,
        name="mfa_download_recovery_codes",
        roles=EVERYBODY,
    ),
    route("account/openid/<slug:provider_id>/", openid.login, name="openid_connect_login", roles=ANYONE),
    route("account/openid/<slug:provider_id>/back/", openid.callback, name="openid_connect_callback", roles=ANYONE),
    route("account/openid-error/", social.login_error, name="socialaccount_login_error", roles=ANYONE),
    route("account/openid-cancelled/", social.login_cancelled, name="socialaccount_login_cancelled", roles=ANYONE),
    route("account/openid-closed/", social.signup, name="socialaccount_signup", roles=ANYONE),
]
HOME = [
    route("alive/", home.alive, name="alive", roles=ANYONE),
]

PHOTOGRAPHS = CARE | RIGS
"""Who sends photographs: of patients, or of a board."""
WORK = [
    route("uploads/", uploads.new, name="upload-new", roles=PHOTOGRAPHS),
    route(
        "uploads/<uuid:upload>/",
        uploads.one,
        name="upload",
        roles=PHOTOGRAPHS,
        body_bytes=uploads.BODY_BYTES,
        atomic=False,
        audited=False,
    ),
    route("uploads/<uuid:upload>/place/", uploads.place, name="upload-place", roles=PHOTOGRAPHS, atomic=False),
    route("uploads/<uuid:upload>/back/", uploads.back, name="upload-back", roles=PHOTOGRAPHS, atomic=False),
    route(
        "uploads/<uuid:upload>/thumbnail/",
        uploads.thumbnail,
        name="upload-thumbnail",
        roles=PHOTOGRAPHS,
        audited=False,  # the page that shows it is an entry
    ),
    route("uploads/<uuid:upload>/screen/", uploads.screen, name="upload-screen", roles=CARE),
    route("visits/<uuid:visit>/uploads/", uploads.of_visit, name="visit-uploads", roles=CARE, audited=False),
    route(
        "calibrations/<uuid:calibration>/uploads/",
        uploads.of_calibration,
        name="calibration-uploads",
        roles=RIGS,
        audited=False,
    ),
    route("checks/<uuid:check>/uploads/", uploads.of_check, name="check-uploads", roles=RIGS, audited=False),
    route("visits/<uuid:visit>/measure/", jobs.measure, name="visit-measure", roles=CARE),
    route("calibrations/<uuid:calibration>/run/", jobs.calibrate, name="calibration-run", roles=RIGS),
    route("checks/<uuid:check>/run/", jobs.check, name="check-run", roles=RIGS),
    route("visits/<uuid:visit>/capture/", capture.visit_capture, name="visit-capture", roles=CARE),
    route("visits/<uuid:visit>/capture/state", capture.visit_state, name="visit-state", roles=CARE, audited=False),
    route(
        "visits/<uuid:visit>/capture/look",
        capture.visit_look,
        name="visit-look",
        roles=CARE,
        atomic=False,  # it waits for the cameras
        audited=False,
    ),
    route("visits/<uuid:visit>/capture/fire", capture.visit_fire, name="visit-fire", roles=CARE, atomic=False),
    route("jobs/", jobs.many, name="jobs", roles=CARE, audited=False),
    route("jobs/events/", jobs.stream, name="job-events", roles=PHOTOGRAPHS, audited=False),
    route("jobs/<uuid:job>/", jobs.one, name="job", roles=PHOTOGRAPHS, audited=False),
    route("jobs/<uuid:job>/cancel/", jobs.cancel, name="job-cancel", roles=PHOTOGRAPHS),
    route("jobs/<uuid:job>/retry/", jobs.retry, name="job-retry", roles=PHOTOGRAPHS),
    route("rigs/<uuid:rig>/today/", rigwork.today, name="rig-today", roles=PHOTOGRAPHS, audited=False),
    route("rigs/<uuid:rig>/drift.png", rigwork.drift, name="rig-drift", roles=PHOTOGRAPHS),
    route("rigs/<uuid:rig>/calibrations/", rigwork.new_calibration, name="calibration-new", roles=RIGS),
    route("rigs/<uuid:rig>/checks/", rigwork.new_check, name="check-new", roles=RIGS),
]


urlpatterns: list[URLPattern | URLResolver] = [*HOME, *PAGES, *ADMINISTRATION, *ACCOUNTS, *WORK]
handler400 = refusals.bad_request
handler403 = refusals.forbidden
handler404 = refusals.missing
handler500 = refusals.broken
