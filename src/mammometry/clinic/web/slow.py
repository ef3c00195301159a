"""Connections on which no request comes.

They are closed: else a thousand silent ones would shut everybody out.
"""

from __future__ import annotations

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol


def closing_silent(seconds: float) -> type[asyncio.Protocol]:
    """Limit how long the head of a request may take.

    HTTP is as uvicorn speaks it. uvicorn closes a connection that rests after an answer, and waits without end for the
    first request and for the rest of a begun one. How long bodies take is counted by `mammometry.clinic.web.limits`.

    Args:
        seconds: from the connection, or the first byte of a later request, to the end of a request's head.
    """

    class ClosingSilent(H11Protocol):
        _silent: asyncio.TimerHandle | None = None

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self._wait()

        def data_received(self, data: bytes) -> None:
            super().data_received(data)
            if self.cycle is None or self.cycle.response_complete:
                self._wait()
            else:
                self._stop()

        def connection_lost(self, exc: Exception | None) -> None:
            self._stop()
            super().connection_lost(exc)

        def _wait(self) -> None:
            if self._silent is None:
                self._silent = self.loop.call_later(seconds, self._close)

        def _stop(self) -> None:
            if self._silent is not None:
                self._silent.cancel()
                self._silent = None

        def _close(self) -> None:
            self.transport.close()

    return ClosingSilent
