"""JSON records that contain their own digest, so that every change is detected."""

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

DIGEST = "digest"
"""Last member of a sealed record: SHA-256 of all bytes before it."""
_SEALED = re.compile(rb'(\{.*),\n "digest": "([0-9a-f]{64})"\n\}\n', re.DOTALL)
_HEX = re.compile("[0-9a-f]{64}")


def sealed(table: Mapping[str, Any]) -> bytes:
    """Write a table as UTF-8 JSON that ends with its own digest.

    Args:
        table: data for JSON, not empty, without a member ``digest``.
    """
    content = json.dumps(table, indent=1).removesuffix("\n}").encode()
    return content + f',\n "{DIGEST}": "{hashlib.sha256(content).hexdigest()}"\n}}\n'.encode()


def unsealed(data: bytes) -> tuple[dict[str, Any], bool]:
    """Read a table, and whether a digest confirms it. Versions up to 1.0.0 did not write one.

    Args:
        data: content of the file.

    Raises:
        ValueError: it is not a JSON object, or was changed after it was written.
    """
    match = _SEALED.fullmatch(data)
    if match is not None and hashlib.sha256(match[1]).hexdigest().encode() == match[2]:
        table: dict[str, Any] = json.loads(match[1] + b"}")
        return table, True
    read = json.loads(data)
    if not isinstance(read, dict):
        raise ValueError("not a JSON object")
    last = next(reversed(read.values()), None)
    # The change may be in the name of the digest itself. Tables of earlier versions do not end with a digest.
    if DIGEST in read or (isinstance(last, str) and _HEX.fullmatch(last)):
        raise ValueError("it was changed since it was written (its digest differs)")
    return read, False
