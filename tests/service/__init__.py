"""A service that keeps its own tables beside kbstore's in one database, as a user of SQLAlchemy writes it."""
