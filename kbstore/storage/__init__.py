"""Rows and messages: the tables of a store, every SQL statement, and who runs them."""
