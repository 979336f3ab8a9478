"""The service's Alembic environment; kbstore's part of it is `include_name`."""

from alembic import context

from kbstore import sql
from tests.service.models import Base

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=Base.metadata,
    include_name=sql.include_name,
    render_as_batch=True,
)
with context.begin_transaction():
    context.run_migrations()
