"""SQLAlchemy-Continuum: a versioned model on SQLite, with its default strategy, `validity`."""

from collections.abc import Iterable
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.ext.compiler import deregister
from sqlalchemy.orm import DeclarativeBase, Mapped, Session, configure_mappers, mapped_column
from sqlalchemy_continuum import (  # type: ignore[import-untyped]
    Operation,
    make_versioned,
    transaction_class,
    version_class,
    versioning_manager,
)

from benchmarks.peers.peer import Change, Standing

make_versioned(user_cls=None)


class _Base(DeclarativeBase):
    """Of the models."""


class _Fact(_Base):
    """What holds: deleting a row withdraws it."""

    __tablename__ = "fact"
    __versioned__: dict[str, Any] = {}  # noqa: RUF012 - as Continuum wants it
    key: Mapped[str] = mapped_column(primary_key=True)
    is_negative: Mapped[bool]


configure_mappers()
_Version: Any = version_class(_Fact)
_Transaction: Any = transaction_class(_Fact)

# For its key, which SQLite fills in where it is an INTEGER, Continuum makes every BigInteger one on SQLite, whoever's
# it is: kbstore's tables, too, in this process.
deregister(sa.BigInteger)
_Transaction.__table__.c.id.type = sa.Integer()


class Continuum:
    """Facts and their versions in an SQLite file, with the settings of a kbstore store."""

    def __init__(self, path: Path) -> None:
        self._engine = sa.create_engine(f"sqlite:///{path}")
        sa.event.listen(self._engine, "connect", _set)
        _Base.metadata.create_all(self._engine)
        self._session = Session(self._engine)

    def tell(self, changes: Iterable[Change]) -> None:
        """Rows of versions written directly, as Continuum leaves them: a session would take a millisecond for each."""
        transactions: list[dict[str, Any]] = []
        versions: list[dict[str, Any]] = []
        latest: dict[str, dict[str, Any]] = {}
        for number, (time, told) in enumerate(groupby(changes, key=lambda change: change.time), 1):
            transactions.append({"id": number, "issued_at": _moment(time), "remote_addr": None})
            for _, key, is_negative in told:
                before = latest.pop(key, None)
                kind = Operation.INSERT if before is None else Operation.UPDATE
                if before is not None:
                    before["end_transaction_id"] = number
                if is_negative is None:
                    kind, is_negative = Operation.DELETE, before is not None and before["is_negative"]  # noqa: PLW2901
                version = {"key": key, "is_negative": is_negative, "transaction_id": number, "operation_type": kind}
                versions.append({**version, "end_transaction_id": None})
                if kind is not Operation.DELETE:
                    latest[key] = versions[-1]
        standing = [{"key": key, "is_negative": version["is_negative"]} for key, version in latest.items()]
        with self._engine.begin() as connection:
            connection.execute(sa.insert(_Transaction.__table__), transactions)
            connection.execute(sa.insert(_Version.__table__), versions)
            connection.execute(sa.insert(_Fact), standing)

    def _number(self, t: int) -> int:
        """The transaction at a time; one after another, so that the key's index finds it fast enough."""
        query = sa.select(_Transaction.id).where(_Transaction.issued_at <= _moment(t))
        return int(self._session.scalar(query.order_by(_Transaction.id.desc()).limit(1)) or 0)

    def state(self, t: int) -> Standing:
        """The versions that hold at the transaction of the time, as columns: entities would take longer."""
        number = self._number(t)
        query = sa.select(_Version.key, _Version.is_negative).where(
            _Version.transaction_id <= number,
            sa.or_(_Version.end_transaction_id > number, _Version.end_transaction_id.is_(None)),
            _Version.operation_type != Operation.DELETE,
        )
        return {key: is_negative for key, is_negative in self._session.execute(query)}  # noqa: C416 - rows, not pairs

    def point(self, key: str, t: int) -> bool:
        """By the fetcher's own query for one version."""
        fetcher = versioning_manager.fetcher(_Fact)
        version = fetcher.version_at(self._session, _Version, {"key": key}, self._number(t))
        return version is not None and version.operation_type != Operation.DELETE and not version.is_negative

    def write(self, change: Change) -> None:
        """Change the entity and commit."""
        fact = self._session.get_one(_Fact, change.key)
        fact.is_negative = bool(change.is_negative)
        self._issue(change.time)

    def bulk(self, keys: list[str], t: int) -> None:
        """Add the entities and commit."""
        self._session.add_all([_Fact(key=key, is_negative=False) for key in keys])
        self._issue(t)

    def _issue(self, t: int) -> None:
        transaction = versioning_manager.unit_of_work(self._session).create_transaction(self._session)
        transaction.issued_at = _moment(t)
        self._session.commit()

    def close(self) -> None:
        """Close the session and the connections."""
        self._session.close()
        self._engine.dispose()


def _moment(t: int) -> datetime:
    return datetime.fromtimestamp(t // 1_000_000_000, UTC).replace(microsecond=t // 1000 % 1_000_000, tzinfo=None)


def _set(connection: Any, _: Any) -> None:
    connection.execute("PRAGMA journal_mode = WAL")
    connection.execute("PRAGMA synchronous = FULL")
    connection.execute("PRAGMA cache_size = -65536")
