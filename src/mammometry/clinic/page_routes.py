"""Routes of the pages, with who may open them."""

from __future__ import annotations

from mammometry.clinic.access import route
from mammometry.clinic.roles import ADMINISTRATOR, CARE, CLINICIAN, EVERYBODY, RIGS, STUDY
from mammometry.clinic.views import (
    compare,
    corrections,
    deliveries,
    exports,
    guide,
    patients,
    results,
    rigs,
    scans,
    settings,
    study,
    today,
    visits,
    worklist,
)
from mammometry.clinic.views.choose import leads_on

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
    route("visits/new/", visits.visit_new, name="visit-new", roles=CARE),
    route("visits/scan/", scans.scan_new, name="scan-new", roles=CARE, body_bytes=scans.BODY_BYTES, atomic=False),
    route("worklist/", worklist.worklist, name="worklist", roles=CARE),
    route("visits/<uuid:visit>/", visits.visit, name="visit", roles=CARE),
    route("visits/<uuid:visit>/move/", corrections.visit_move, name="visit-move", roles=CARE),
    route("visits/<uuid:visit>/date/", corrections.visit_date, name="visit-date", roles=CARE),
    route("visits/<uuid:visit>/bin/", corrections.visit_bin, name="visit-bin", roles=CARE),
    route("corrections/", corrections.corrections, name="corrections", roles=CARE | ADMINISTRATOR),
    route("corrections/<uuid:correction>/undo/", corrections.correction_undo, name="correction-undo", roles=CARE),
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
    route("visits/<uuid:visit>/draw/confirm", results.confirm, name="draw-confirm", roles=CLINICIAN),
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
]
