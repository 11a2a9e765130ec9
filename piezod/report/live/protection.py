"""Who may see the live page: requests under known host names, from the page itself, outside frames of other pages."""

from collections.abc import Sequence
from typing import Any

from bokeh.server.tornado import BokehTornado
from tornado.httputil import HTTPHeaders, HTTPMessageDelegate, HTTPServerRequest
from tornado.web import ErrorHandler, OutputTransform

from piezod.config.host_name import is_permitted

FORBIDDEN = 403


class ProtectedPages(BokehTornado):
    """Pages of Bokeh that answer only under known host names.

    Parameters
    ----------
    names
        Host names under which the page may be opened, without port.
    settings
        Further arguments of `BokehTornado`.
    """

    def __init__(self, application: Any, names: Sequence[str], **settings: Any) -> None:  # noqa: ANN401  # of Bokeh
        super().__init__(application, extra_websocket_origins=[f"{name}:*" for name in names], **settings)
        self._names = {name.lower() for name in names}
        self.add_transform(ProtectionHeaders)

    def find_handler(self, request: HTTPServerRequest, **kwargs: Any) -> HTTPMessageDelegate:  # noqa: ANN401
        """Handler of a request; 403 for a foreign host or origin."""
        if not is_permitted(request.host, request.headers.get("Origin"), self._names):
            return self.get_handler_delegate(request, ErrorHandler, {"status_code": FORBIDDEN})
        handler: HTTPMessageDelegate = super().find_handler(request, **kwargs)
        return handler


class ProtectionHeaders(OutputTransform):  # type: ignore[misc]  # Tornado has no types
    """Headers of every answer: no foreign scripts, no foreign frames, no use of the values by other pages."""

    def __init__(self, request: HTTPServerRequest) -> None:
        self._host = request.host

    def transform_first_chunk(
        self,
        status_code: int,
        headers: HTTPHeaders,
        chunk: bytes,
        finishing: bool,  # noqa: ARG002  # of Tornado
    ) -> tuple[int, HTTPHeaders, bytes]:
        """Set the headers."""
        sources = {
            "default-src": "'none'",
            "script-src": "'self' 'unsafe-inline'",  # Bokeh's template starts the page by a script inside it
            "style-src": "'self' 'unsafe-inline'",
            "img-src": "'self' data: blob:",
            "font-src": "'self' data:",
            "connect-src": f"'self' ws://{self._host} wss://{self._host}" if status_code != FORBIDDEN else "'none'",
            "frame-ancestors": "'none'",
            "base-uri": "'none'",
            "form-action": "'none'",
        }
        headers["Content-Security-Policy"] = "; ".join(f"{name} {value}" for name, value in sources.items())
        headers["X-Frame-Options"] = "DENY"
        headers["X-Content-Type-Options"] = "nosniff"
        headers["Referrer-Policy"] = "no-referrer"
        headers["Cross-Origin-Resource-Policy"] = headers["Cross-Origin-Opener-Policy"] = "same-origin"
        for name in [name for name in headers if name.lower().startswith("access-control-")]:
            del headers[name]
        return status_code, headers, chunk
