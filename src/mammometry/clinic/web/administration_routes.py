"""Routes of the administrators' pages."""

from __future__ import annotations

from mammometry.clinic.roles import ADMINISTRATOR, RIGS
from mammometry.clinic.views.administration import audit, deliveries, erasing, first_day, people, settings, upkeep
from mammometry.clinic.views.administration import overview as administration
from mammometry.clinic.web.access import route

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
