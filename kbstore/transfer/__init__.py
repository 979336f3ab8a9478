"""Keeping a store for years: backups, exports, archives."""
