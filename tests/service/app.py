"""The service's web interface: messages in, results out."""

from fastapi import FastAPI

import kbstore


def make_app(kb):
    """Return the application of one knowledge base."""
    app = FastAPI()

    @app.post("/knowledge", response_model=kbstore.Transaction)
    def add(item: kbstore.KnowledgeItem):
        return kb.add(item)

    @app.get("/facts", response_model=list[kbstore.Fact])
    def facts(name: str = ""):
        return kb.propositions(name)

    @app.get("/history", response_model=list[kbstore.Assertion])
    def history(pattern: str):
        return kb.history(pattern)

    @app.get("/state")
    def state():
        return kb.state().to_dict()

    return app
