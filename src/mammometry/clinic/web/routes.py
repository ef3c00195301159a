"""The one table of routes. Each line says who may open it: `access.route`."""

from __future__ import annotations

from allauth.account import views as account
from allauth.mfa.base import views as mfa
from allauth.mfa.recovery_codes import views as recovery
from allauth.mfa.totp import views as totp
from allauth.socialaccount import views as social
from allauth.socialaccount.providers.openid_connect import views as openid
from django.urls import URLPattern, URLResolver

from mammometry.clinic.roles import ADMINISTRATOR, ANYONE, CARE, CLINICIAN, EVERYBODY, RIGS, STUDY
from mammometry.clinic.views import guide, home, jobs, refusals, rigs, rigwork, study, today, who
from mammometry.clinic.views.administration import audit, deliveries, erasing, first_day, people, settings, upkeep
from mammometry.clinic.views.administration import overview as administration
from mammometry.clinic.views.patient import (
    capture,
    clinical,
    compare,
    corrections,
    exports,
    patients,
    results,
    scans,
    uploads,
    visits,
    worklist,
)
from mammometry.clinic.views.patient.choose import leads_on
from mammometry.clinic.web.access import route, set_up_route

_EDITOR_BYTES = 1 << 20  # of a drawing with all its points
_SEES_RIGS = RIGS | CLINICIAN

PAGES = [
    route("", today.today, name="home", roles=EVERYBODY),
    route("help/", guide.guide, name="help", roles=EVERYBODY, audited=False),
    route("patients/", patients.patients, name="patients", roles=CARE),
    route("patients/new/", patients.patient_new, name="patient-new", roles=CARE),
    route("patients/<uuid:patient>/", leads_on(patients.patient), name="patient", roles=CARE),
    route("patients/<uuid:patient>/edit/", leads_on(patients.patient_edit), name="patient-edit", roles=CARE),
    route("patients/<uuid:patient>/merge/", corrections.patient_merge, name="patient-merge", roles=CARE),
    route("patients/<uuid:patient>/bin/", corrections.patient_bin, name="patient-bin", roles=CARE),
    route("patients/<uuid:patient>/compare/", leads_on(compare.compare), name="compare", roles=CLINICIAN),
    route(
        "patients/<uuid:patient>/compare/<uuid:before>/<uuid:after>/",
        compare.compare_page,
        name="compare-page",
        roles=CLINICIAN,
    ),
    route(
        "patients/<uuid:patient>/compare/<uuid:before>/<uuid:after>/scene/",
        compare.compare_scene,
        name="compare-scene",
        roles=CLINICIAN,
        audited=False,
    ),
    route(
        "patients/<uuid:patient>/changes/",
        compare.patient_changes,
        name="patient-changes",
        roles=CARE,
        audited=False,
    ),
    route("patients/<uuid:patient>/operations/new/", clinical.operation_new, name="operation-new", roles=CARE),
    route("operations/<uuid:operation>/edit/", clinical.operation_edit, name="operation-edit", roles=CARE),
    route("operations/<uuid:operation>/remove/", clinical.operation_remove, name="operation-remove", roles=CARE),
    route("patients/<uuid:patient>/consents/new/", clinical.consent_new, name="consent-new", roles=CARE),
    route("consents/<uuid:consent>/edit/", clinical.consent_edit, name="consent-edit", roles=CARE),
    route("visits/new/", visits.visit_new, name="visit-new", roles=CARE),
    route("visits/scan/", scans.scan_new, name="scan-new", roles=CARE, body_bytes=scans.BODY_BYTES, atomic=False),
    route("worklist/", worklist.worklist, name="worklist", roles=CARE),
    route("visits/<uuid:visit>/", visits.visit, name="visit", roles=CARE),
    route(
        "visits/<uuid:visit>/refused/<str:name>.png",
        visits.refused_picture,
        name="refused-picture",
        roles=CARE,
        audited=False,
    ),
    route("visits/<uuid:visit>/move/", corrections.visit_move, name="visit-move", roles=CARE),
    route("visits/<uuid:visit>/date/", corrections.visit_date, name="visit-date", roles=CARE),
    route("visits/<uuid:visit>/bin/", corrections.visit_bin, name="visit-bin", roles=CARE),
    route("corrections/", corrections.corrections, name="corrections", roles=CARE | ADMINISTRATOR),
    route("corrections/<uuid:correction>/undo/", corrections.correction_undo, name="correction-undo", roles=CARE),
    route("visits/<uuid:visit>/verdict/", compare.visit_verdict, name="visit-verdict", roles=CARE, audited=False),
    route("visits/<uuid:visit>/circumstances/", clinical.circumstances, name="circumstances", roles=CARE),
    route("visits/<uuid:visit>/conclusion/", clinical.conclude, name="conclude", roles=CLINICIAN),
    route("visits/<uuid:visit>/report/", results.report, name="report", roles=CARE),
    route("visits/<uuid:visit>/report.pdf", results.report_pdf, name="report-pdf", roles=CARE),
    route("visits/<uuid:visit>/send/", deliveries.visit_send, name="visit-send", roles=CLINICIAN),
    route("visits/<uuid:visit>/dicom.zip", exports.visit_dicom, name="visit-dicom", roles=CLINICIAN),
    route("visits/<uuid:visit>/fhir-<slug:release>.json", exports.visit_fhir, name="visit-fhir", roles=CLINICIAN),
    route("deliveries/<uuid:delivery>/retry/", deliveries.delivery_retry, name="delivery-retry", roles=CLINICIAN),
    route("visits/<uuid:visit>/scene/", results.scene, name="scene", roles=CARE, audited=False),
    route("visits/<uuid:visit>/draw/", results.draw, name="draw", roles=CLINICIAN),
    route("visits/<uuid:visit>/draw/drawing", results.drawing, name="draw-drawing", roles=CLINICIAN, audited=False),
    route("visits/<uuid:visit>/draw/items", results.items, name="draw-items", roles=CLINICIAN, audited=False),
    route(
        "visits/<uuid:visit>/draw/measure",
        results.measure,
        name="draw-measure",
        roles=CLINICIAN,
        body_bytes=_EDITOR_BYTES,
        atomic=False,
        audited=False,
    ),
    route("visits/<uuid:visit>/draw/save", results.save, name="draw-save", roles=CLINICIAN, body_bytes=_EDITOR_BYTES),
    route("visits/<uuid:visit>/draw/finish", results.finish, name="draw-finish", roles=CLINICIAN),
    route("jobs/page/", visits.jobs, name="jobs-page", roles=CARE),
    route("rigs/", rigs.rigs, name="rigs", roles=_SEES_RIGS),
    route("rigs/new/", rigs.rig_new, name="rig-new", roles=RIGS),
    route("rigs/<uuid:rig>/", rigs.rig, name="rig", roles=_SEES_RIGS),
    route("rigs/<uuid:rig>/edit/", rigs.rig_edit, name="rig-edit", roles=RIGS),
    route("calibrations/<uuid:calibration>/", rigs.calibration, name="calibration", roles=_SEES_RIGS),
    route("checks/<uuid:check>/", rigs.check, name="check", roles=_SEES_RIGS),
    route("study/", study.study, name="study", roles=STUDY),
    route("study/cohort.csv", study.study_csv, name="study-csv", roles=STUDY),
    route("study/redcap.zip", exports.study_redcap, name="study-redcap", roles=STUDY),
    route("study/table.zip", exports.study_table, name="study-table", roles=STUDY),
]


ADMINISTRATION = [
    route("administration/", administration.overview, name="administration", roles=ADMINISTRATOR),
    route("people/", people.people, name="people", roles=ADMINISTRATOR),
    route("people/new/", people.person_new, name="person-new", roles=ADMINISTRATOR),
    route("people/<uuid:person>/", people.person_edit, name="person", roles=ADMINISTRATOR),
    route("people/<uuid:person>/invite/", people.invite, name="person-invite", roles=ADMINISTRATOR),
    route("people/<uuid:person>/second-factor/", people.reset_second_factor, name="person-factor", roles=ADMINISTRATOR),
    route("people/<uuid:person>/let-in/", people.let_in, name="person-let-in", roles=ADMINISTRATOR),
    route("audit/", audit.audit, name="audit", roles=ADMINISTRATOR),
    route("audit/audit.csv", audit.audit_csv, name="audit-csv", roles=ADMINISTRATOR),
    route("audit/<int:entry>/", audit.audit_entry, name="audit-entry", roles=ADMINISTRATOR),
    route("backups/", upkeep.backups, name="backups", roles=ADMINISTRATOR),
    route("backups/make/", upkeep.backup_now, name="backup-make", roles=ADMINISTRATOR, atomic=False),
    route("backups/test/", upkeep.test_now, name="backup-test", roles=ADMINISTRATOR, atomic=False),
    route("disk/", upkeep.disk, name="disk", roles=ADMINISTRATOR),
    route("erase/", erasing.erase, name="erase", roles=ADMINISTRATOR, atomic=False),
    route("archives/", deliveries.destinations, name="destinations", roles=ADMINISTRATOR),
    route("archives/new/", deliveries.destination_new, name="destination-new", roles=ADMINISTRATOR),
    route("archives/<uuid:destination>/", deliveries.destination_edit, name="destination-edit", roles=ADMINISTRATOR),
    route(
        "archives/<uuid:destination>/test/",
        deliveries.destination_test,
        name="destination-test",
        roles=ADMINISTRATOR,
        atomic=False,  # it waits for the archive
    ),
    route("settings/", settings.settings, name="settings", roles=ADMINISTRATOR),
    route("rigs/<uuid:rig>/target.pdf", first_day.target, name="rig-target", roles=RIGS),
]


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
