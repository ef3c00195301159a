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


class PersonForm(_Form):
    """A person with roles to tick."""

    roles = forms.MultipleChoiceField(choices=Role.choices, widget=forms.CheckboxSelectMultiple, required=False)

    class Meta:
        model = Person
        fields = ("username", "full_name", "email", "roles", "is_active")


@admin.register(Person)
class PersonAdmin(_Admin):
    """Enter people, change their roles, let nobody be deleted."""

    form = PersonForm
    list_display = ("username", "full_name", "shown_roles", "is_active", "last_login")
    search_fields = ("username", "full_name", "email")
    actions = ("invite", "forget_second_factor", "unlock")

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
