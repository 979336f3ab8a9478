"""Errors as answers: ``application/problem+json`` (RFC 9457) with kbstore's sentences."""

from http import HTTPStatus
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from kbstore import errors

MEDIA_TYPE = "application/problem+json"

STATUSES: list[tuple[type[errors.KbStoreError], int]] = [
    (errors.PddlSyntaxError, 400),
    (errors.InvalidTime, 400),
    (errors.UndefinedFunction, 404),
    (errors.HistoryUnavailable, 410),
    (errors.NotApplicable, 409),
    (errors.Conflict, 409),
    (errors.StoreWentBack, 409),
    (errors.ClockWentBackwards, 503),
    (errors.ClockJumped, 503),
    (errors.StoreUnavailable, 503),
    (errors.SchemaOutOfDate, 503),
    (errors.SchemaTooNew, 503),
    (errors.SchemaUnknown, 503),
    (errors.KbStoreError, 422),
]
"""The status of each error; the first that fits."""

SCHEMA: dict[str, Any] = {
    "title": "Problem",
    "type": "object",
    "required": ["type", "title", "status", "detail"],
    "properties": {
        "type": {"type": "string", "const": "about:blank"},
        "title": {"type": "string"},
        "status": {"type": "integer"},
        "detail": {"type": "string", "description": "What was wrong, what was expected, and what to do."},
        "error": {"type": "string", "description": "The name of kbstore's error.", "examples": ["UnknownSymbol"]},
        "violations": {"type": "array", "items": {"type": "string"}},
        "line": {"type": "integer"},
        "column": {"type": "integer"},
    },
}

RESPONSES: dict[int | str, dict[str, Any]] = {
    status: {"description": what, "content": {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}}
    for status, what in (("4XX", "The request cannot be answered."), ("5XX", "The store cannot be asked now."))
}
"""The problem responses of every operation."""


class Refused(Exception):
    """Raised for a request that the service itself refuses."""

    def __init__(self, status: int, detail: str, **headers: str) -> None:
        super().__init__(detail)
        self.status = status
        self.detail = detail
        self.headers = {name.replace("_", "-"): value for name, value in headers.items()}


def problem(status: int, detail: str, headers: dict[str, str] | None = None, **more: Any) -> JSONResponse:
    """Return a problem as a response."""
    found = {"type": "about:blank", "title": HTTPStatus(status).phrase, "status": status, "detail": detail, **more}
    return JSONResponse(found, status, headers, MEDIA_TYPE)


def of_error(error: errors.KbStoreError) -> JSONResponse:
    """Return kbstore's error as a response."""
    status = next(status for kind, status in STATUSES if isinstance(error, kind))
    more: dict[str, Any] = {"error": type(error).__name__}
    if isinstance(error, errors.InvalidKnowledge):
        more["violations"] = list(error.violations)
    if isinstance(error, errors.PddlSyntaxError):
        more |= {"line": error.line, "column": error.column}
    return problem(status, str(error), **more)


def install(app: FastAPI) -> None:
    """Let an application answer with a problem for each error."""

    @app.exception_handler(errors.KbStoreError)
    async def _kbstore(request: Request, error: errors.KbStoreError) -> JSONResponse:
        return of_error(error)

    @app.exception_handler(Refused)
    async def _refused(request: Request, error: Refused) -> JSONResponse:
        return problem(error.status, error.detail, error.headers)

    @app.exception_handler(RequestValidationError)
    async def _invalid(request: Request, error: RequestValidationError) -> JSONResponse:
        wrong = [f"{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()]
        return problem(422, "; ".join(wrong), violations=wrong)

    @app.exception_handler(HTTPException)
    async def _http(request: Request, error: HTTPException) -> JSONResponse:
        return problem(error.status_code, error.detail, dict(error.headers or {}))
