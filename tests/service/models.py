"""The service's own tables: parcels, and the orders to move them."""

from sqlalchemy import ForeignKey, MetaData, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column


class Base(DeclarativeBase):
    """The service's models."""

    metadata = MetaData(
        naming_convention={"fk": "fk_%(table_name)s_%(referred_table_name)s", "pk": "pk_%(table_name)s"}
    )


class Parcel(Base):
    """A parcel to be delivered."""

    __tablename__ = "parcels"

    name: Mapped[str] = mapped_column(Text, primary_key=True)
    weight: Mapped[float]


class Order(Base):
    """An order to bring a parcel to a place."""

    __tablename__ = "orders"

    id: Mapped[int] = mapped_column(primary_key=True)
    parcel: Mapped[str] = mapped_column(ForeignKey("parcels.name"))
    place: Mapped[str] = mapped_column(Text)
