"""Common to PlanSys2's two experts: a table of services, and how requests are answered or refused."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

from kbstore.errors import KbStoreError

Service = Callable[[Any, Any], None]
"""A function that reads a request and fills in a response."""


class Expert:
    """Answers services by their names; `TYPES` maps these to types of `plansys2_msgs.srv`."""

    TYPES: ClassVar[Mapping[str, str]] = {}

    def answer(self, service: str, request: Any, response: Any) -> Any:
        """Answer a request in the response, which is returned.

        An error of kbstore's sets `error_info`, and `success` to false. A response without these fields has `exist`,
        which is set to false.
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
        """Fill in a response for a request that is refused, with the reason if it has a field for one."""
        if hasattr(response, "success"):
            response.success, response.error_info = False, reason
        else:
            response.exist = False
        return response
