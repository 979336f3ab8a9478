"""Copies of stores and knowledge bases: backups, exports and imports, archives, pushes."""
