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

    @app.get("/history", response_model=kbstore.Assertions)
    def history(pattern: str):
        return kb.history(pattern)

    @app.get("/state", response_model=kbstore.State)
    def state():
        return kb.state()

    @app.get("/annotated-state")
    def annotated_state() -> kbstore.State:
        return kb.state()

    @app.get("/bare-state")
    def bare_state():
        return kb.state()

    @app.get("/bare-history")
    def bare_history(pattern: str):
        return kb.history(pattern)

    @app.get("/plain")
    def plain(pattern: str):
        return {"state": kb.state().to_dict(), "history": kb.history(pattern).to_dict()}

    return app
