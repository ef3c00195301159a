"""Server of all pages: uvicorn with limits for silent and slow clients."""

import asyncio
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

_HEAD_BYTES = 64 * 1024  # largest head of a request; h11 sends 400 for a larger one
_CONNECTIONS = 1000  # then 503; each takes about 50 kB
_END_S = 10  # for requests in progress when the server is stopped


class HeadTimed(H11Protocol):
    """Limit the time for a request's head, by uvicorn's timer of idle connections.

    uvicorn starts this timer after an answer only, and stops it at the next byte: it waits without limit for the first
    request and for the rest of a head. Here it starts with the connection, and stops at the end of a head.
    """

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Start the timer."""
        super().connection_made(transport)
        self.timeout_keep_alive_task = self.loop.call_later(self.timeout_keep_alive, self.timeout_keep_alive_handler)

    def data_received(self, data: bytes) -> None:
        """Read on. The timer is not stopped, as uvicorn would."""
        self.conn.receive_data(data)
        self.handle_events()

    def handle_events(self) -> None:
        """Stop the timer if a request's head has ended."""
        super().handle_events()
        if self.cycle is not None and not self.cycle.response_complete:
            self._unset_keepalive_if_required()


def server(application: Any, *, request_s: float, **options: Any) -> uvicorn.Server:
    """A server, for `run`.

    Args:
        application: ASGI, behind `limits.Limited`, which times bodies.
        request_s: seconds from the connection, or the end of an answer, to the end of the next request's head.
        options: uvicorn's others.
    """
    config = uvicorn.Config(
        application, http=HeadTimed, ws="none", lifespan="off", log_config=None, server_header=False,
        access_log=False,  # a query may contain a name
        timeout_keep_alive=request_s,  # type: ignore[arg-type]  # given to the event loop, which takes fractions
        timeout_graceful_shutdown=_END_S, limit_concurrency=_CONNECTIONS, h11_max_incomplete_event_size=_HEAD_BYTES,
        **options,
    )  # fmt: skip
    return uvicorn.Server(config)
