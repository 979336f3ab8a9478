"""The service's tables."""

import sqlalchemy as sa
from alembic import op

revision = "first"
down_revision = None


def upgrade():
    """Make the tables."""
    op.create_table(
        "parcels",
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("weight", sa.Double(), nullable=False),
        sa.PrimaryKeyConstraint("name", name="pk_parcels"),
    )
    op.create_table(
        "orders",
        sa.Column("id", sa.Integer(), nullable=False),
        sa.Column("parcel", sa.Text(), nullable=False),
        sa.Column("place", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_orders"),
        sa.ForeignKeyConstraint(["parcel"], ["parcels.name"], name="fk_orders_parcels"),
    )
