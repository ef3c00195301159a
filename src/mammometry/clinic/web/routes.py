"""Table of routes, with the roles that may open each (`access.route`)."""

from allauth.account import views as account
from allauth.mfa.base import views as mfa
from allauth.mfa.recovery_codes import views as recovery
from allauth.mfa.totp import views as totp
from allauth.socialaccount import views as social
from allauth.socialaccount.providers.openid_connect import views as openid
from django.urls import URLPattern, URLResolver

from mammometry.clinic.roles import ADMINISTRATOR, ANYONE, CARE, CLINICIAN, EVERYBODY, RIGS, STUDY
from mammometry.clinic.views import (
    administration,
    corrections,
    hospital,
    jobs,
    own_account,
    patients,
    responses,
    results,
    rigs,
    scans,
    study,
    today,
    uploads,
    visits,
    walks,
)
from mammometry.clinic.views.patients import leads_on
from mammometry.clinic.web.access import route

_EDITOR_BYTES = 1 << 20  # a drawing with all its points
_SEES_RIGS = RIGS | CLINICIAN

PAGES = [
    route("", today.today, "home", EVERYBODY),
    route("help/", today.guide, "help", EVERYBODY, audited=False),
    route("patients/", patients.patients, "patients", CARE),
    route("patients/new/", patients.patient_form, "patient-new", CARE),
    route("patients/<uuid:patient>/", leads_on(patients.patient), "patient", CARE),
    route("patients/<uuid:patient>/edit/", leads_on(patients.patient_form), "patient-edit", CARE),
    route("patients/<uuid:patient>/notes/", leads_on(patients.patient_notes), "patient-notes", CARE),
    route("patients/<uuid:patient>/merge/", corrections.patient_merge, "patient-merge", CARE),
    route("patients/<uuid:patient>/bin/", corrections.patient_bin, "patient-bin", CARE),
    route("patients/<uuid:patient>/compare/", leads_on(results.compare), "compare", CLINICIAN),
    route(
        "patients/<uuid:patient>/compare/<uuid:before>/<uuid:after>/", results.compare_page, "compare-page", CLINICIAN
    ),
    route(
        "patients/<uuid:patient>/compare/<uuid:before>/<uuid:after>/scene/",
        results.compare_scene,
        "compare-scene",
        CLINICIAN,
        audited=False,
    ),
    route("patients/<uuid:patient>/changes/", results.patient_changes, "patient-changes", CARE, audited=False),
    route("patients/<uuid:patient>/operations/new/", patients.operation_new, "operation-new", CARE),
    route("operations/<uuid:operation>/edit/", patients.operation_edit, "operation-edit", CARE),
    route("operations/<uuid:operation>/remove/", patients.operation_remove, "operation-remove", CARE),
    route("patients/<uuid:patient>/consents/new/", patients.consent_new, "consent-new", CARE),
    route("consents/<uuid:consent>/edit/", patients.consent_edit, "consent-edit", CARE),
    route("visits/new/", visits.visit_new, "visit-new", CARE),
    route("visits/scan/", scans.scan_new, "scan-new", CARE, body_bytes=scans.BODY_BYTES, atomic=False),
    route("visits/telephone/", walks.walk_new, "walk-new", CARE),
    route("visits/telephone/board.pdf", walks.walk_target, "walk-target", CARE, audited=False),
    route("visits/<uuid:visit>/board/", walks.walk_board, "walk-board", CARE),
    route("visits/<uuid:visit>/again/", walks.walk_again, "walk-again", CARE),
    route("worklist/", hospital.worklist, "worklist", CARE),
    route("visits/<uuid:visit>/", visits.visit_page, "visit", CARE),
    route("visits/<uuid:visit>/refused/<str:name>.png", visits.refused_picture, "refused-picture", CARE, audited=False),
    route("visits/<uuid:visit>/move/", corrections.visit_move, "visit-move", CARE),
    route("visits/<uuid:visit>/date/", corrections.visit_date, "visit-date", CARE),
    route("visits/<uuid:visit>/bin/", corrections.visit_bin, "visit-bin", CARE),
    route("corrections/", corrections.corrections, "corrections", CARE | ADMINISTRATOR),
    route("corrections/<uuid:correction>/undo/", corrections.correction_undo, "correction-undo", CARE),
    route("visits/<uuid:visit>/verdict/", results.visit_verdict, "visit-verdict", CARE, audited=False),
    route("visits/<uuid:visit>/circumstances/", visits.circumstances, "circumstances", CARE),
    route("visits/<uuid:visit>/sides/", scans.scan_sides, "scan-sides", CLINICIAN),
    route("visits/<uuid:visit>/conclusion/", visits.conclude, "conclude", CLINICIAN),
    route("visits/<uuid:visit>/report/", results.report, "report", CARE),
    route("visits/<uuid:visit>/report.pdf", results.report_pdf, "report-pdf", CARE),
    route("visits/<uuid:visit>/send/", hospital.visit_send, "visit-send", CLINICIAN),
    route("visits/<uuid:visit>/dicom.zip", study.visit_dicom, "visit-dicom", CLINICIAN),
    route("visits/<uuid:visit>/fhir-<slug:release>.json", study.visit_fhir, "visit-fhir", CLINICIAN),
    route("deliveries/<uuid:delivery>/retry/", hospital.delivery_retry, "delivery-retry", CLINICIAN),
    route("visits/<uuid:visit>/scene/", results.scene, "scene", CARE, audited=False),
    route("visits/<uuid:visit>/draw/", results.draw, "draw", CLINICIAN),
    route("visits/<uuid:visit>/draw/drawing", results.drawing, "draw-drawing", CLINICIAN, audited=False),
    route("visits/<uuid:visit>/draw/items", results.items, "draw-items", CLINICIAN, audited=False),
    route(
        "visits/<uuid:visit>/draw/measure",
        results.measure,
        "draw-measure",
        CLINICIAN,
        body_bytes=_EDITOR_BYTES,
        atomic=False,
        audited=False,
    ),
    route("visits/<uuid:visit>/draw/save", results.save, "draw-save", CLINICIAN, body_bytes=_EDITOR_BYTES),
    route("visits/<uuid:visit>/draw/finish", results.finish, "draw-finish", CLINICIAN),
    route("jobs/page/", visits.jobs, "jobs-page", CARE),
    route("rigs/", rigs.rigs, "rigs", _SEES_RIGS),
    route("rigs/new/", rigs.rig_form, "rig-new", RIGS),
    route("rigs/board.svg", rigs.board, "board-drawn", RIGS, audited=False),
    route("rigs/<uuid:rig>/session.toml", rigs.session_toml, "rig-manifest", RIGS),
    route("rigs/<uuid:rig>/", rigs.rig, "rig", _SEES_RIGS),
    route("rigs/<uuid:rig>/edit/", rigs.rig_form, "rig-edit", RIGS),
    route("calibrations/<uuid:calibration>/", rigs.calibration, "calibration", _SEES_RIGS),
    route("calibrations/<uuid:calibration>/leave-out/", rigs.leave_out, "calibration-leave-out", RIGS),
    route("calibrations/<uuid:calibration>/use/", rigs.use, "calibration-use", RIGS),
    route(
        "calibrations/<uuid:calibration>/photographs/<str:pose>/<str:camera>.webp",
        rigs.board_picture,
        "board-picture",
        _SEES_RIGS,
        audited=False,
    ),
    route("checks/<uuid:check>/", rigs.check, "check", _SEES_RIGS),
    route("checks/<uuid:check>/put-right/", rigs.check_put_right, "check-put-right", RIGS),
    route("study/", study.study, "study", STUDY),
    route("study/cohort.csv", study.study_csv, "study-csv", STUDY),
    route("study/redcap.zip", study.study_redcap, "study-redcap", STUDY),
    route("study/table.zip", study.study_table, "study-table", STUDY),
]


ADMINISTRATION = [
    route("administration/", administration.overview, "administration", ADMINISTRATOR),
    route("people/", administration.people, "people", ADMINISTRATOR),
    route("people/new/", administration.person_new, "person-new", ADMINISTRATOR),
    route("people/<uuid:person>/", administration.person_edit, "person", ADMINISTRATOR),
    route("people/<uuid:person>/invite/", administration.invite, "person-invite", ADMINISTRATOR),
    route("people/<uuid:person>/second-factor/", administration.reset_second_factor, "person-factor", ADMINISTRATOR),
    route("people/<uuid:person>/let-in/", administration.let_in, "person-let-in", ADMINISTRATOR),
    route("audit/", administration.audit, "audit", ADMINISTRATOR),
    route("audit/audit.csv", administration.audit_csv, "audit-csv", ADMINISTRATOR),
    route("audit/<int:entry>/", administration.audit_entry, "audit-entry", ADMINISTRATOR),
    route("backups/", administration.backup_list, "backups", ADMINISTRATOR),
    route("backups/make/", administration.backup_now, "backup-make", ADMINISTRATOR),
    route("backups/test/", administration.test_now, "backup-test", ADMINISTRATOR),
    route("disk/", administration.disk, "disk", ADMINISTRATOR),
    route("erase/", administration.erase, "erase", ADMINISTRATOR, atomic=False),
    route("archives/", hospital.destinations, "destinations", ADMINISTRATOR),
    route("archives/new/", hospital.destination_form, "destination-new", ADMINISTRATOR),
    route("archives/<uuid:destination>/", hospital.destination_form, "destination-edit", ADMINISTRATOR),
    route(
        "archives/<uuid:destination>/test/", hospital.destination_test, "destination-test", ADMINISTRATOR, atomic=False
    ),  # it waits for the archive
    route("settings/", administration.settings, "settings", ADMINISTRATOR),
    route("rigs/<uuid:rig>/target.pdf", rigs.target, "rig-target", RIGS),
]


ACCOUNTS = [
    route("account/login/", account.login, "account_login", ANYONE, atomic=False),
    route("account/token/", responses.token, "account-token", ANYONE, audited=False),
    route("account/logout/", account.logout, "account_logout", ANYONE),
    route("account/inactive/", account.account_inactive, "account_inactive", ANYONE),
    route("account/code/", own_account.enter_code, "mfa_authenticate", ANYONE),
    route(
        r"^account/invitation/(?P<uidb36>[0-9A-Za-z]+)-(?P<key>.+)/$",
        account.password_reset_from_key,
        "account_reset_password_from_key",
        ANYONE,
    ),
    route(
        "account/invitation/done/", account.password_reset_from_key_done, "account_reset_password_from_key_done", ANYONE
    ),
    route("account/password/", own_account.change_password, "account_change_password", EVERYBODY),
    route("account/again/", account.reauthenticate, "account_reauthenticate", EVERYBODY, first_factor=True),
    route("account/again/code/", mfa.reauthenticate, "mfa_reauthenticate", EVERYBODY, first_factor=True),
    route("account/second/", mfa.index, "mfa_index", EVERYBODY, first_factor=True),
    route("account/second/set-up/", totp.activate_totp, "mfa_activate_totp", EVERYBODY, first_factor=True),
    route("account/second/remove/", totp.deactivate_totp, "mfa_deactivate_totp", EVERYBODY),
    route("account/second/codes/", recovery.view_recovery_codes, "mfa_view_recovery_codes", EVERYBODY),
    route("account/second/codes/new/", recovery.generate_recovery_codes, "mfa_generate_recovery_codes", EVERYBODY),
    route("account/second/codes/file/", recovery.download_recovery_codes, "mfa_download_recovery_codes", EVERYBODY),
    route("account/openid/<slug:provider_id>/", openid.login, "openid_connect_login", ANYONE),
    route("account/openid/<slug:provider_id>/back/", openid.callback, "openid_connect_callback", ANYONE),
    route("account/openid-error/", social.login_error, "socialaccount_login_error", ANYONE),
    route("account/openid-cancelled/", social.login_cancelled, "socialaccount_login_cancelled", ANYONE),
    route("account/openid-closed/", social.signup, "socialaccount_signup", ANYONE),
]
HOME = [route("alive/", today.alive, "alive", ANYONE)]

PHOTOGRAPHS = CARE | RIGS
"""Roles that may send photographs, of patients or of a board."""
WORK = [
    route("uploads/", uploads.new, "upload-new", PHOTOGRAPHS),
    route(
        "uploads/<uuid:upload>/",
        uploads.one,
        "upload",
        PHOTOGRAPHS,
        body_bytes=uploads.BODY_BYTES,
        atomic=False,
        audited=False,
    ),
    route("uploads/<uuid:upload>/place/", uploads.place, "upload-place", PHOTOGRAPHS, atomic=False),
    route("uploads/<uuid:upload>/back/", uploads.back, "upload-back", PHOTOGRAPHS, atomic=False),
    route(
        "uploads/<uuid:upload>/thumbnail/", uploads.thumbnail, "upload-thumbnail", PHOTOGRAPHS, audited=False
    ),  # the page that shows it is recorded
    route("uploads/<uuid:upload>/screen/", uploads.screen, "upload-screen", CARE),
    route("visits/<uuid:visit>/put-right/", uploads.put_right, "visit-put-right", CARE, atomic=False),
    route("visits/<uuid:visit>/uploads/", uploads.of_visit, "visit-uploads", CARE, audited=False),
    route(
        "calibrations/<uuid:calibration>/uploads/", uploads.of_calibration, "calibration-uploads", RIGS, audited=False
    ),
    route("checks/<uuid:check>/uploads/", uploads.of_check, "check-uploads", RIGS, audited=False),
    route("visits/<uuid:visit>/measure/", jobs.measure, "visit-measure", CARE),
    route("calibrations/<uuid:calibration>/run/", jobs.calibrate, "calibration-run", RIGS),
    route("checks/<uuid:check>/run/", jobs.check, "check-run", RIGS),
    route("visits/<uuid:visit>/capture/", visits.visit_capture, "visit-capture", CARE),
    route("visits/<uuid:visit>/capture/state", visits.visit_state, "visit-state", CARE, audited=False),
    route(
        "visits/<uuid:visit>/capture/look", visits.visit_look, "visit-look", CARE, atomic=False, audited=False
    ),  # it waits for the cameras
    route("visits/<uuid:visit>/capture/fire", visits.visit_fire, "visit-fire", CARE, atomic=False),
    route("jobs/", jobs.many, "jobs", CARE, audited=False),
    route("jobs/events/", jobs.stream, "job-events", PHOTOGRAPHS, audited=False),
    route("jobs/<uuid:job>/", jobs.one, "job", PHOTOGRAPHS, audited=False),
    route("jobs/<uuid:job>/cancel/", jobs.cancel, "job-cancel", PHOTOGRAPHS),
    route("jobs/<uuid:job>/retry/", jobs.retry, "job-retry", PHOTOGRAPHS),
    route("rigs/<uuid:rig>/today/", rigs.today, "rig-today", PHOTOGRAPHS, audited=False),
    route("rigs/<uuid:rig>/drift.png", rigs.drift, "rig-drift", PHOTOGRAPHS),
    route("rigs/<uuid:rig>/calibrations/", rigs.new_calibration, "calibration-new", RIGS),
    route("rigs/<uuid:rig>/checks/", rigs.new_check, "check-new", RIGS),
]


urlpatterns: list[URLPattern | URLResolver] = [*HOME, *PAGES, *ADMINISTRATION, *ACCOUNTS, *WORK]
handler400 = responses.bad_request
handler403 = responses.forbidden
handler404 = responses.missing
handler500 = responses.broken
