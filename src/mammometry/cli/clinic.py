"""The commands `clinic …`: the web application of one clinic."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mammometry.base.extras import WEB, require
from mammometry.base.shell import command_line
from mammometry.cli.common import Answer, Bars, JsonOptions, OutputOptions, command

if TYPE_CHECKING:
    from mammometry.base.progress import Progress
    from mammometry.clinic.config import ClinicConfig

app = typer.Typer(name="clinic", help="Patients, visits, rigs and people in one place: a web application.")
people = typer.Typer(name="people", help="Who may log in.")
app.add_typer(people, no_args_is_help=True)

_LIBRARIES = (*WEB, "django", "allauth", "argon2", "axes", "auditlog", "whitenoise", "distributed")
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="The clinic's folder.", show_default=False)]
RoleNames = Annotated[
    list[str], typer.Option("--role", help="technician, clinician, researcher or administrator. May be repeated.")
]


@app.callback()
def installed() -> None:
    """Refuse if the clinic's libraries are not installed."""
    require("clinic", *_LIBRARIES)


def opened(folder: Path, **changes: object) -> ClinicConfig:
    """Read a clinic's settings and use them in this process."""
    from mammometry.clinic.config import read_config
    from mammometry.clinic.site import configure

    config = read_config(folder).model_copy(update=changes)
    configure(config)
    return config


@command(app, "mammometry clinic init my-clinic", "mammometry clinic init my-clinic --database postgresql:///clinic")
def init(
    options: JsonOptions,
    folder: Folder,
    name: Annotated[str, typer.Option(help="Name on the clinic's pages.")] = "Clinic",
    database: Annotated[str, typer.Option(help="sqlite, or postgresql://user:password@host/name.")] = "sqlite",
    time_zone: Annotated[
        str | None,
        typer.Option(
            metavar="ZONE", help="Time zone, such as Europe/Berlin. Without it, you are asked.", show_default=False
        ),
    ] = None,
    administrator: Annotated[str | None, typer.Option(metavar="NAME", help="Create this first administrator.")] = None,
) -> Answer:
    """Make the folder and the database of a new clinic.

    A terminal asks for the time zone; otherwise that of this machine is used.
    """
    from mammometry.clinic.config import machine_time_zone, new_clinic
    from mammometry.clinic.web.server import migrate

    zone = time_zone or machine_time_zone()
    if time_zone is None and sys.stdin.isatty() and not options.json:
        zone = typer.prompt("Time zone of the clinic", default=zone, err=True)
    config = new_clinic(folder, name=name, database=database, time_zone=zone)
    opened(folder)
    migrate(config)
    lines = [f"Settings: {folder / 'clinic.toml'}, time zone {zone}"]
    table: dict[str, object] = {"clinic": str(folder), "time_zone": zone}
    if administrator is not None:
        invited = _invite(config, administrator, ["administrator"], "", "")
        table |= invited.table
        lines += [str(line) for line in invited.lines]
    else:
        lines.append(f"Then: {command_line('mammometry', 'clinic', 'people', 'add', folder)} NAME --role administrator")
    return Answer(table, [*lines, f"Then: {command_line('mammometry', 'clinic', 'serve', folder)}"])


@command(app, "mammometry clinic serve my-clinic")
def serve(
    options: JsonOptions,
    folder: Folder,
    address: Annotated[str | None, typer.Option(metavar="HOST:PORT", help="Listen here.", show_default=False)] = None,
    tls_certificate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Certificate, PEM.", show_default=False)
    ] = None,
    tls_key: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Private key of the certificate, PEM.", show_default=False)
    ] = None,
    jobs: Annotated[bool, typer.Option("--jobs/--no-jobs", help="Measure on this machine, too.")] = True,
) -> Answer:
    """Serve the clinic until Ctrl-C."""
    from mammometry.clinic.config import read_config
    from mammometry.clinic.web.server import require_free
    from mammometry.clinic.web.server import serve as run

    changes: dict[str, object] = {} if address is None else {"address": address}
    if tls_certificate is not None or tls_key is not None:
        if tls_certificate is None or tls_key is None:
            raise typer.BadParameter("--tls-certificate and --tls-key belong together")
        tls = read_config(folder).tls
        changes["tls"] = tls.model_copy(update={"certificate": str(tls_certificate), "key": str(tls_key)})
    config = opened(folder, **changes)
    require_free(config.address)
    scheme = "https" if config.tls.used else "http"
    print(f"{scheme}://{config.address}/ (Ctrl-C stops)", file=sys.stderr, flush=True)  # noqa: T201
    run(config, jobs=jobs)
    return Answer({"clinic": str(folder)})


@command(app, "mammometry clinic work my-clinic")
def work(options: JsonOptions, folder: Folder) -> Answer:
    """Measure queued visits until Ctrl-C.

    For a second machine, or together with `serve --no-jobs`. It must see the clinic's folder under the same path.
    """
    config = opened(folder)
    from mammometry.clinic.web.server import require_current
    from mammometry.clinic.web.server import work as serve_queue

    require_current(config)
    serve_queue(config.folder)
    return Answer({"clinic": str(folder)})


@command(app, "mammometry clinic demo", "mammometry clinic demo my-demo --no-serve")
def demo(
    options: OutputOptions,
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Folder for the demo.")] = Path("demo-clinic"),
    serve: Annotated[bool, typer.Option("--serve/--no-serve", help="Serve the clinic when it is ready.")] = True,
    address: Annotated[str, typer.Option(metavar="HOST:PORT", help="Listen here.")] = "127.0.0.1:8000",
) -> Answer:
    """Make a clinic of three virtual patients, and serve it.

    Each patient has two visits. An existing demo is served as it is.
    """
    from mammometry.clinic.demo import finish_beside, make_demo
    from mammometry.clinic.web.server import beside, require_free
    from mammometry.clinic.web.server import serve as run

    if serve:
        require_free(address)
    table: dict[str, object] = {"clinic": str(folder)}
    lines: list[str] = []
    if (folder / "clinic.toml").is_file():
        lines.append(f"{folder} already exists; its passwords were shown when it was made.")
        config = opened(folder, address=address)
    else:
        with Bars(options.silent) as bars, ExitStack() as shown:

            def say(what: str) -> Progress:
                shown.close()
                return shown.enter_context(bars.task(what, "of it"))

            made = make_demo(folder, say, address=address, whole=not serve)
        config = made.config
        table |= {
            "visits": made.visits,
            "measured": made.measured,
            "failed": made.failed,
            "seconds": round(made.seconds, 1),
            "people": made.passwords,
        }
        if serve:
            lines.append(f"Made in {made.seconds:.0f} s. Its {made.visits} visits are measured while you look around.")
        else:
            lines.append(f"{made.measured} of {made.visits} visits measured in {made.seconds:.0f} s.")
        lines += [f"{who}: {why}" for who, why in made.failed.items()]
        lines += [f"Log in as {name}, password {password}" for name, password in made.passwords.items()]
    if not serve:
        return Answer(table, [*lines])
    for line in (*lines, f"http://{config.address}/ (Ctrl-C stops)"):
        print(line, file=sys.stderr, flush=True)  # noqa: T201
    with beside(finish_beside, config.folder, again=False):
        run(config)
    return Answer(table)


@command(app)
def upgrade(options: JsonOptions, folder: Folder) -> Answer:
    """Upgrade the database to this version.

    First stop the server and make a backup with the former version. If it is killed, run the same command again.
    """
    from mammometry.clinic.web.server import migrate

    done = migrate(opened(folder))
    lines = [f"Applied: {', '.join(done)}"] if done else ["The database is current."]
    return Answer({"applied": done}, [*lines])


Target = Annotated[Path | None, typer.Option("--to", metavar="FILE", help="Backup file to write.", show_default=False)]
Who = Annotated[str, typer.Argument(metavar="PATIENT", help="Pseudonym or record number.", show_default=False)]


@command(app, "mammometry clinic backup my-clinic --to /backup/clinic-monday.tar")
def backup(options: JsonOptions, folder: Folder, to: Target = None) -> Answer:
    """Write database, settings, keys and photographs into one file.

    The clinic may be in use. Without --to the file is stored with the clinic's backups, of which the newest are kept.
    """
    config = opened(folder)
    from mammometry.clinic.maintenance.backups import make_backup, make_kept_backup
    from mammometry.clinic.web.server import require_current

    require_current(config)
    made = make_kept_backup(config) if to is None else make_backup(config, to)
    return Answer({"backup": str(made)}, [f"{made}: {made.stat().st_size / 1e6:.1f} MB. It contains names and keys."])


@command(app, "mammometry clinic test-restore my-clinic", name="test-restore")
def check_restore(options: JsonOptions, folder: Folder) -> Answer:
    """Restore the newest backup into a temporary folder and check it.

    It needs as much free space as the backup's size. The clinic may be in use.
    """
    from mammometry.clinic.config import read_config
    from mammometry.clinic.maintenance import restore

    made = restore.run_restore_test(read_config(folder))
    table = {"backup": made.backup, "rows": made.rows, "files": made.files, "seconds": round(made.seconds, 1)}
    return Answer(table, [made.sentence])


@command(app, "mammometry clinic restore clinic-monday.tar new-clinic")
def restore(
    options: JsonOptions,
    archive: Annotated[Path, typer.Argument(metavar="FILE", help="A backup.", show_default=False)],
    folder: Folder,
    database: Annotated[
        str | None,
        typer.Option(help="Use a different database from the backup's, such as postgresql://…", show_default=False),
    ] = None,
) -> Answer:
    """Restore a clinic from a backup, into a new folder and an empty database."""
    from mammometry.clinic.maintenance.restore import fill, unpack

    config, manifest = unpack(archive, folder, database)
    opened(config.folder)
    number = fill(config, manifest, folder)
    lines = [f"{folder}: the clinic of {manifest['made_at']}, {number} people."]
    return Answer({"clinic": str(folder), "made_at": manifest["made_at"], "people": number}, [*lines])


@command(app, "mammometry clinic export my-clinic P-ACD347 --to P-ACD347.zip")
def export(options: JsonOptions, folder: Folder, patient: Who, to: Target = None) -> Answer:
    """Write all data of one patient into a ZIP file."""
    config = opened(folder)
    from mammometry.clinic.maintenance.patient import export_patient, find_patient

    found_patient = find_patient(patient)
    target = to or Path(f"{found_patient.pseudonym}.zip")
    number = export_patient(config, found_patient, target)
    return Answer({"export": str(target), "files": number}, [f"{target}: {number} files. It contains the name."])


@command(app, "mammometry clinic erase my-clinic P-ACD347 --yes")
def erase(
    options: JsonOptions,
    folder: Folder,
    patient: Who,
    binned: Annotated[bool, typer.Option("--bin", help="Only the patient's visits in the bin.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Erase without asking.")] = False,
) -> Answer:
    """Erase one patient: photographs, results and all rows.

    The audit keeps the pseudonym. Earlier backups still contain the patient.
    """
    config = opened(folder)
    from mammometry.clinic.maintenance.backups import remove_leftovers
    from mammometry.clinic.maintenance.patient import copies, erase_bin, erase_patient, find_patient
    from mammometry.clinic.models import Visit

    found_patient = find_patient(patient)
    name = found_patient.pseudonym
    if not yes:
        visits = Visit.everything.filter(patient=found_patient)
        words = (
            f"the {visits.exclude(binned_at=None).count()} visits of {name} in the bin"
            if binned
            else f"{name} with {visits.count()} visits"
        )
        typer.confirm(f"Erase {words}? It cannot be undone.", abort=True, err=True)
    remove_leftovers(config)
    kept = copies(config, found_patient)
    number = erase_bin(found_patient) if binned else erase_patient(config, found_patient)
    lines = [f"{number} visits of {name} are erased." if binned else f"{name} is erased, with {number} visits."]
    lines += [f"A copy remains: {copy}." for copy in kept]
    return Answer({"erased": name, "visits": number, "copies": kept}, [*lines])


@command(app, "mammometry clinic audit my-clinic --to audit.csv")
def audit(options: JsonOptions, folder: Folder, to: Target = None) -> Answer:
    """Write who saw and changed what, as CSV."""
    opened(folder)
    from mammometry.clinic.audit_entries import write_audit

    target = to or Path("audit.csv")
    if target.exists():
        from mammometry.clinic.config import ClinicError

        raise ClinicError(str(target), found="a file", expected="none", remedy="Name another file with --to")
    with target.open("x", encoding="utf-8", newline="") as file:
        number = write_audit(file)
    return Answer({"audit": str(target), "entries": number}, [f"{target}: {number} entries"])


@command(people, "mammometry clinic people add my-clinic anna --role technician --name 'Anna A.'", name="add")
def people_add(
    options: JsonOptions,
    folder: Folder,
    username: Annotated[str, typer.Argument(metavar="NAME", help="To log in with.", show_default=False)],
    role: RoleNames,
    name: Annotated[str, typer.Option(help="Full name, as shown on pages.")] = "",
    email: Annotated[str, typer.Option(help="E-mail address of the person's hospital login.")] = "",
) -> Answer:
    """Add a person, and print the link for setting a password."""
    return _invite(opened(folder), username, role, name, email)


@command(people, name="list")
def people_list(options: JsonOptions, folder: Folder) -> Answer:
    """Who may log in."""
    opened(folder)
    from mammometry.clinic.models import Person

    rows: list[dict[str, Any]] = [
        {
            "name": person.username,
            "full_name": person.full_name,
            "roles": list(person.roles),
            "active": person.is_active,
        }
        for person in Person.objects.all()
    ]
    lines = [f"{row['name']}  {', '.join(row['roles'])}{'' if row['active'] else '  (inactive)'}" for row in rows]
    return Answer({"people": rows}, [*lines])


@command(people, name="invite")
def people_invite(
    options: JsonOptions,
    folder: Folder,
    username: Annotated[str, typer.Argument(metavar="NAME", help="Who forgot the password.", show_default=False)],
) -> Answer:
    """Print a new link for setting a password."""
    config = opened(folder)
    from mammometry.clinic.accounts import find_person

    return _invitation(config, find_person(username))


def _invite(config: ClinicConfig, username: str, roles: list[str], name: str, email: str) -> Answer:
    from mammometry.clinic.accounts import add_person
    from mammometry.clinic.roles import Role

    unknown = sorted(set(roles) - {role.value for role in Role})
    if unknown:
        raise typer.BadParameter(f"unknown role: {', '.join(unknown)}; roles are {', '.join(Role.values)}")
    chosen = [Role(role) for role in dict.fromkeys(roles)]
    return _invitation(config, add_person(username, chosen, full_name=name, email=email))


def _invitation(config: ClinicConfig, person: object) -> Answer:
    from mammometry.clinic.accounts import invitation
    from mammometry.clinic.models import Person

    assert isinstance(person, Person)
    scheme = "https" if config.tls.used else "http"
    host = config.address if config.hosts[0] in ("localhost", "127.0.0.1") else config.hosts[0]
    link = f"{scheme}://{host}{invitation(person)}"
    return Answer(
        {"name": person.username, "link": link},
        [f"{person.username} sets a password here (works once, for three days):", link],
    )
