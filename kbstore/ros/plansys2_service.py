"""The services of PlanSys2's experts: a table of names and types, and how a question is answered or refused."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from kbstore.errors import KbStoreError

Service = Callable[[Any, Any], None]
"""Reads a request and fills in a response."""


class Expert:
    """Answers services by name; `TYPES` has the type of each, of `plansys2_msgs.srv`."""

    TYPES: ClassVar[Mapping[str, str]] = {}

    def answer(self, service: str, request: Any, response: Any) -> Any:
        """Answer a request in the response, which is returned.

        An error of kbstore is `error_info`, and not a success; where the response has neither field, what is asked for
        does not exist.
        """
        try:
            getattr(self, service)(request, response)
        except KbStoreError as error:
            self.refuse(response, str(error))
        else:
            if hasattr(response, "success"):
                response.success = True
        return response

    @staticmethod
    def refuse(response: Any, reason: str) -> Any:
        """Answer that a request is refused, and why."""
        if hasattr(response, "success"):
            response.success, response.error_info = False, reason
        else:
            response.exist = False
        return response
