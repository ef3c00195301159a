"""Django's settings, derived from a clinic's. A process can open only one clinic."""

import logging
import os
import re
import traceback
from typing import Any

from mammometry.clinic.config import ClinicConfig, ClinicError, OpenId

_PACKAGE = "mammometry.clinic"
_CONNECTED_S = 60
"""Seconds for which a thread keeps its database connection. Opening one costs as much as a small page."""


def configure(config: ClinicConfig) -> None:
    """Configure this process for the clinic. Its models can be imported afterwards.

    Later changes of clinic.toml have no effect on this process.

    Raises:
        ClinicError: the process has already opened another clinic.
    """
    import django
    from django.conf import settings

    if settings.configured:
        if config.folder.resolve() != the_clinic().folder.resolve():
            remedy = "Use a process for each clinic"
            raise ClinicError(str(config.folder), found="another open clinic", expected="none", remedy=remedy)
        return
    settings.configure(**settings_of(config, config.secret_key))
    django.setup()


def the_clinic() -> ClinicConfig:
    """The clinic that this process has opened."""
    from django.conf import settings

    opened: ClinicConfig = getattr(settings, "CLINIC")  # noqa: B009  # not one of Django's own
    return opened


def application(config: ClinicConfig) -> Any:
    """The clinic as an ASGI application."""
    configure(config)
    from mammometry.clinic.web.requests import ClinicLimited, Dispatcher

    return ClinicLimited(Dispatcher(), config.limits)


def settings_of(config: ClinicConfig, secret_key: str) -> dict[str, Any]:
    """Django's settings for a clinic."""
    tls = config.tls.used
    return {
        "CLINIC": config,
        "DEBUG": False,
        "SECRET_KEY": secret_key,
        "ALLOWED_HOSTS": list(config.hosts),
        "CSRF_TRUSTED_ORIGINS": [f"https://{host}" for host in config.hosts] if config.tls.behind_proxy else [],
        "ROOT_URLCONF": f"{_PACKAGE}.web.routes",
        "INSTALLED_APPS": _APPS,
        "MIDDLEWARE": _MIDDLEWARE,
        "TEMPLATES": [_templates()],
        "DATABASES": {"default": database(config)},
        "DEFAULT_AUTO_FIELD": "django.db.models.BigAutoField",
        "AUTH_USER_MODEL": "clinic.Person",
        "USE_TZ": True,
        "TIME_ZONE": config.time_zone,
        "LANGUAGE_CODE": "en",
        "STATIC_URL": "/static/",
        "WHITENOISE_USE_FINDERS": True,
        "WHITENOISE_ALLOW_ALL_ORIGINS": False,
        "CACHES": {"default": {"BACKEND": "django.core.cache.backends.locmem.LocMemCache"}},
        "LOGGING": _logging(config),
        **_cookies(config, tls),
        **_uploads(config),
        **_logins(config),
        "AUDITLOG_DISABLE_ON_RAW_SAVE": True,
    }


def database(config: ClinicConfig) -> dict[str, Any]:
    """Django's settings of the clinic's database.

    Raises:
        ClinicError: the address is of an unknown kind of database.
    """
    if config.database == "sqlite":
        return {
            "ENGINE": "django.db.backends.sqlite3",
            "NAME": str(config.folder / "clinic.sqlite3"),
            "CONN_MAX_AGE": _CONNECTED_S,
            "OPTIONS": {
                "timeout": 20,  # seconds that a writer waits for another
                "transaction_mode": "IMMEDIATE",  # otherwise a transaction that reads first could fail when it writes
                # Erased data are overwritten. Commits are written to the disk. Deletions by REPLACE fire triggers.
                "init_command": "PRAGMA journal_mode=WAL; PRAGMA synchronous=FULL; PRAGMA secure_delete=ON; "
                "PRAGMA recursive_triggers=ON;",
            },
        }
    if not config.database.startswith(("postgresql://", "postgres://")):
        expected = "sqlite or postgresql://user:password@host:port/name"
        raise ClinicError(
            "clinic.toml, database", found="another address", expected=expected, remedy="Correct the line database"
        )
    from psycopg import ProgrammingError
    from psycopg.conninfo import conninfo_to_dict

    try:
        parts = conninfo_to_dict(config.database)
    except ProgrammingError:
        expected = "postgresql://user:password@host:port/name"
        raise ClinicError(
            "clinic.toml, database", found="an address that cannot be read", expected=expected,
            remedy="Write letters such as @ and / in a password as %40 and %2F",
        ) from None  # fmt: skip
    named = {"dbname": "NAME", "user": "USER", "password": "PASSWORD", "host": "HOST", "port": "PORT"}
    django_names = {named[key]: str(value) for key, value in parts.items() if key in named}
    return {
        "ENGINE": "django.db.backends.postgresql",
        **django_names,
        "CONN_MAX_AGE": _CONNECTED_S,
        "CONN_HEALTH_CHECKS": True,  # the database server may have been restarted
        "OPTIONS": {key: value for key, value in parts.items() if key not in named},
    }


_APPS = [
    f"{_PACKAGE}.apps.ClinicApp",
    "django.contrib.auth",
    "django.contrib.contenttypes",
    "django.contrib.sessions",
    "django.contrib.messages",
    "whitenoise.runserver_nostatic",
    "django.contrib.staticfiles",
    "allauth",
    "allauth.account",
    "allauth.mfa",
    "allauth.socialaccount",
    "allauth.socialaccount.providers.openid_connect",
    "axes",
    "auditlog",
]
_MIDDLEWARE = [
    f"{_PACKAGE}.web.security.Headers",
    "django.middleware.security.SecurityMiddleware",
    "whitenoise.middleware.WhiteNoiseMiddleware",
    "django.contrib.sessions.middleware.SessionMiddleware",
    "django.middleware.common.CommonMiddleware",
    "django.middleware.csrf.CsrfViewMiddleware",
    "django.contrib.auth.middleware.AuthenticationMiddleware",
    f"{_PACKAGE}.web.security.Expiry",
    "django.contrib.messages.middleware.MessageMiddleware",
    "allauth.account.middleware.AccountMiddleware",
    "auditlog.middleware.AuditlogMiddleware",
    f"{_PACKAGE}.web.security.DeniedByDefault",
    "axes.middleware.AxesMiddleware",
]


def _templates() -> dict[str, Any]:
    return {
        "BACKEND": "django.template.backends.django.DjangoTemplates",
        "APP_DIRS": True,
        "OPTIONS": {
            "context_processors": [
                "django.template.context_processors.request",
                "django.contrib.auth.context_processors.auth",
                "django.contrib.messages.context_processors.messages",
                f"{_PACKAGE}.web.security.for_all_pages",
            ]
        },
    }


def _cookies(config: ClinicConfig, tls: bool) -> dict[str, Any]:
    prefix = "__Host-" if tls else ""
    return {
        "SESSION_COOKIE_NAME": f"{prefix}clinic-session",
        "SESSION_COOKIE_SECURE": tls,
        "SESSION_COOKIE_HTTPONLY": True,
        "SESSION_COOKIE_SAMESITE": "Lax",  # Strict would break the return from the hospital's login
        "SESSION_COOKIE_AGE": config.limits.session_hours * 3600,
        "SESSION_EXPIRE_AT_BROWSER_CLOSE": True,
        "CSRF_COOKIE_NAME": f"{prefix}clinic-csrf",
        "CSRF_COOKIE_SECURE": tls,
        "CSRF_COOKIE_HTTPONLY": True,
        "CSRF_COOKIE_SAMESITE": "Lax",
        "CSRF_FAILURE_VIEW": f"{_PACKAGE}.views.responses.forged",
        "SECURE_CONTENT_TYPE_NOSNIFF": True,
        "SECURE_REFERRER_POLICY": "same-origin",
        "SECURE_CROSS_ORIGIN_OPENER_POLICY": "same-origin",
        "SECURE_SSL_REDIRECT": tls,
        "SECURE_HSTS_SECONDS": 365 * 24 * 3600 if tls else 0,
    }


def _uploads(config: ClinicConfig) -> dict[str, Any]:
    return {
        "DATA_UPLOAD_MAX_MEMORY_SIZE": 64 * 1024 * 1024,  # the route's own limit is smaller
        "DATA_UPLOAD_MAX_NUMBER_FIELDS": 500,
        "DATA_UPLOAD_MAX_NUMBER_FILES": 20,
        "FILE_UPLOAD_PERMISSIONS": 0o600,
        "FILE_UPLOAD_DIRECTORY_PERMISSIONS": 0o700,
        "FILE_UPLOAD_TEMP_DIR": str(config.folder / "uploads"),
    }


def _logins(config: ClinicConfig) -> dict[str, Any]:
    made: dict[str, Any] = {
        "LOGIN_URL": "account_login",
        "LOGIN_REDIRECT_URL": "/",
        "AUTHENTICATION_BACKENDS": [
            "axes.backends.AxesStandaloneBackend",
            "allauth.account.auth_backends.AuthenticationBackend",
        ],
        "PASSWORD_HASHERS": ["django.contrib.auth.hashers.Argon2PasswordHasher"],
        "AUTH_PASSWORD_VALIDATORS": [
            {"NAME": "django.contrib.auth.password_validation.MinimumLengthValidator", "OPTIONS": {"min_length": 12}},
            {"NAME": "django.contrib.auth.password_validation.CommonPasswordValidator"},
            {
                "NAME": "django.contrib.auth.password_validation.UserAttributeSimilarityValidator",
                "OPTIONS": {"user_attributes": ("username", "full_name", "email")},
            },
        ],
        "PASSWORD_RESET_TIMEOUT": 3 * 24 * 3600,  # validity of an invitation
        "EMAIL_BACKEND": "django.core.mail.backends.dummy.EmailBackend",  # invitations are handed over in person
        "ACCOUNT_ADAPTER": f"{_PACKAGE}.accounts.Accounts",
        "ACCOUNT_FORMS": {
            "login": f"{_PACKAGE}.accounts.LoginForm",
            "reset_password_from_key": f"{_PACKAGE}.accounts.FirstPasswordForm",
            "change_password": f"{_PACKAGE}.accounts.ChangePasswordForm",
            "reauthenticate": f"{_PACKAGE}.accounts.PasswordAgainForm",
        },
        "ACCOUNT_LOGIN_METHODS": {"username"},
        "ACCOUNT_SIGNUP_FIELDS": ["username*", "password1*"],
        "ACCOUNT_EMAIL_VERIFICATION": "none",
        "ACCOUNT_EMAIL_NOTIFICATIONS": False,
        "ACCOUNT_SESSION_REMEMBER": False,
        "ACCOUNT_LOGOUT_REDIRECT_URL": "account_login",
        "ACCOUNT_LOGIN_ON_PASSWORD_RESET": False,
        "ACCOUNT_LOGOUT_ON_PASSWORD_CHANGE": True,
        "ACCOUNT_REAUTHENTICATION_TIMEOUT": 600,
        # axes counts wrong passwords by name and address. By name alone, anybody could lock out others.
        "ACCOUNT_RATE_LIMITS": {"login_failed": "30/m/ip"},
        "MFA_ADAPTER": f"{_PACKAGE}.accounts.SecondFactor",
        "MFA_FORMS": {
            "authenticate": f"{_PACKAGE}.accounts.CodeForm",
            "reauthenticate": f"{_PACKAGE}.accounts.CodeAgainForm",
            "activate_totp": f"{_PACKAGE}.accounts.SetUpForm",
        },
        "MFA_SUPPORTED_TYPES": ["totp", "recovery_codes"],
        "MFA_TOTP_ISSUER": config.name,
        "SOCIALACCOUNT_EMAIL_AUTHENTICATION": True,
        "SOCIALACCOUNT_EMAIL_AUTHENTICATION_AUTO_CONNECT": True,
        "SOCIALACCOUNT_PROVIDERS": {},
        "AXES_FAILURE_LIMIT": config.limits.wrong_passwords,
        "AXES_COOLOFF_TIME": config.limits.wait_minutes / 60,  # hours
        "AXES_LOCKOUT_PARAMETERS": [["username", "ip_address"]],
        "AXES_USERNAME_CALLABLE": f"{_PACKAGE}.audit.tried_name",
        "AXES_RESET_ON_SUCCESS": True,
        "AXES_LOCKOUT_CALLABLE": f"{_PACKAGE}.views.responses.locked_out",
        "AXES_IPWARE_PROXY_COUNT": 0,
        "AXES_VERBOSE": False,
    }
    if config.openid is not None:
        made["SOCIALACCOUNT_PROVIDERS"] = hospital_login(config.openid, config.openid_secret)
    return made


def hospital_login(openid: OpenId, secret: str) -> dict[str, Any]:
    """Allauth's settings for the hospital's own login."""
    app = {
        "provider_id": "hospital",
        "name": openid.name,
        "client_id": openid.client,
        "secret": secret,
        "settings": {"server_url": openid.server},
    }
    return {"openid_connect": {"OAUTH_PKCE_ENABLED": True, "APPS": [app]}}


def _logging(config: ClinicConfig) -> dict[str, Any]:
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"plain": {"()": f"{_PACKAGE}.site.Plain"}},
        "handlers": {
            "file": {
                "class": "logging.handlers.RotatingFileHandler",
                "filename": os.fspath(config.folder / "logs" / "clinic.log"),
                "maxBytes": 10_000_000,
                "backupCount": 10,
                "delay": True,
                "formatter": "plain",
            }
        },
        "root": {"handlers": ["file"], "level": "WARNING"},
        "loggers": {
            "django": {"handlers": ["file"], "level": "WARNING", "propagate": False},
            "mammometry.clinic": {"handlers": ["file"], "level": "INFO", "propagate": False},
        },
    }


_INVITATION = re.compile(r"(/invitation/).+")  # the rest of the path allows to set a password


class Plain(logging.Formatter):
    """Log format: time, level, origin and message.

    Of an exception only its class and the lines of code are written, because its message may contain text that a user
    has typed (those of PostgreSQL do). Of a request only the path is written, which has random keys and no search
    words.
    """

    def format(self, record: logging.LogRecord) -> str:
        """Format a log record as one line of text."""
        message = record.getMessage() if record.name.startswith("mammometry.") else str(record.msg)
        request = getattr(record, "request", None)
        if request is not None:
            path = _INVITATION.sub(r"\1…", request.path)
            message = f"{getattr(record, 'status_code', '')} {request.method} {path}"
        line = f"{self.formatTime(record)} {record.levelname} {record.name}: {_one_line(message)}"
        if record.exc_info and record.exc_info[1] is not None:
            error = record.exc_info[1]
            frames = traceback.extract_tb(error.__traceback__)
            line += f"\n  {type(error).__name__} in " + " < ".join(
                f"{frame.name} ({frame.filename}:{frame.lineno})" for frame in reversed(frames)
            )
        return line


def _one_line(text: str) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in text)[:500]
