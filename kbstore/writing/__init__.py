"""The one path for writing: a transaction, its handlers, its change set, and the rows that result."""
