"""What administrators see in the admin: people, and the audit to read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from auditlog.admin import LogEntryAdmin
from auditlog.models import LogEntry
from django import forms
from django.contrib import admin, messages
from django.http import HttpRequest
from django.utils.html import format_html

from mammometry.clinic.accounts.people import invitation
from mammometry.clinic.models import Person
from mammometry.clinic.roles import Role

if TYPE_CHECKING:
    _Form = forms.ModelForm[Person]
    _Admin = admin.ModelAdmin[Person]
else:  # neither can be subscripted while the program runs
    _Form, _Admin = forms.ModelForm, admin.ModelAdmin


_PERSON_HELP = (
    "Everybody has a login of their own, so that the audit says who did what. Nobody is deleted: take “may log in” "
    "away when somebody leaves. Technicians photograph and measure; clinicians also confirm, draw and compare; "
    "researchers see pseudonyms only; administrators keep people, rigs and the audit, and see no results."
)


class PersonForm(_Form):
    """A person with roles to tick."""

    roles = forms.MultipleChoiceField(choices=Role.choices, widget=forms.CheckboxSelectMultiple)
    own = False
    """Whether administrators edit themselves."""

    class Meta:
        model = Person
        fields = ("username", "full_name", "email", "roles", "is_active")
        labels = {"username": "Name for the login", "is_active": "May log in"}  # noqa: RUF012
        help_texts = {"username": "Letters and digits.", "is_active": ""}  # noqa: RUF012

    def clean(self) -> dict[str, Any]:
        """Refuse that administrators lock themselves out."""
        found: dict[str, Any] = super().clean() or self.cleaned_data
        if self.own and (Role.ADMINISTRATOR not in found.get("roles", ()) or not found.get("is_active")):
            raise forms.ValidationError(
                "You cannot take the administrator's role or the login from yourself. Let another administrator do it."
            )
        return found


@admin.register(Person)
class PersonAdmin(_Admin):
    """Enter people, change their roles, let nobody be deleted."""

    form = PersonForm
    fieldsets = ((None, {"fields": PersonForm.Meta.fields, "description": _PERSON_HELP}),)
    list_display = ("username", "full_name", "shown_roles", "is_active", "last_login")
    search_fields = ("username", "full_name", "email")
    actions = ("invite", "forget_second_factor", "unlock")

    def get_form(self, request: HttpRequest, obj: Person | None = None, change: bool = False, **options: Any) -> Any:
        """Return the form, which knows whether administrators edit themselves."""
        form = super().get_form(request, obj, change, **options)
        form.own = obj is not None and obj.pk == request.user.pk  # type: ignore[attr-defined]
        return form

    @admin.display(description="Roles")
    def shown_roles(self, person: Person) -> str:
        """Roles in words."""
        return ", ".join(person.roles)

    def has_delete_permission(self, request: HttpRequest, obj: Any = None) -> bool:
        """No: the audit names them."""
        return False

    def save_model(self, request: HttpRequest, obj: Person, form: Any, change: bool) -> None:
        """Save, and give a new person a link to set a password."""
        if not change:
            obj.set_unusable_password()
        super().save_model(request, obj, form, change)
        if not change:
            self._say_invitation(request, obj)

    @admin.action(description="New link to set a password")
    def invite(self, request: HttpRequest, people: Any) -> None:
        """Show links that work once."""
        for person in people:
            self._say_invitation(request, person)

    @admin.action(description="Forget the second factor (a lost telephone)")
    def forget_second_factor(self, request: HttpRequest, people: Any) -> None:
        """Remove authenticators, so that the person sets up another one."""
        from allauth.mfa.models import Authenticator

        for person in people:
            Authenticator.objects.filter(user=person).delete()
            person.save()
            messages.info(request, f"{person} sets up a second factor at the next login.")

    @admin.action(description="Let in again after too many wrong passwords")
    def unlock(self, request: HttpRequest, people: Any) -> None:
        """Forget wrong passwords."""
        from axes.utils import reset

        for person in people:
            reset(username=person.username)
            messages.info(request, f"{person} may try again.")

    def _say_invitation(self, request: HttpRequest, person: Person) -> None:
        link = request.build_absolute_uri(invitation(person))
        messages.info(request, format_html("Hand this link to {}; it works once, for three days: {}", person, link))


class AuditAdmin(LogEntryAdmin):
    """The audit, to read."""

    def has_delete_permission(self, request: HttpRequest, obj: Any = None) -> bool:
        """No."""
        return False


admin.site.unregister(LogEntry)
admin.site.register(LogEntry, AuditAdmin)
