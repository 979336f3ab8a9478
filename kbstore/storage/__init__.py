"""The tables of a store, its SQL statements, and the connections that execute them."""
