"""Routes of the pages, with who may open them."""

from __future__ import annotations

from mammometry.clinic.roles import ADMINISTRATOR, CARE, CLINICIAN, EVERYBODY, RIGS, STUDY
from mammometry.clinic.views import guide, rigs, study, today
from mammometry.clinic.views.administration import deliveries
from mammometry.clinic.views.patient import (
    clinical,
    compare,
    corrections,
    exports,
    patients,
    results,
    scans,
    visits,
    worklist,
)
from mammometry.clinic.views.patient.choose import leads_on
from mammometry.clinic.web.access import route

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
