"""The one path for writing: a transaction's draft, its checks, what each update does, and its rows."""
