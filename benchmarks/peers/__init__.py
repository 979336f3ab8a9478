"""Peers: other ways to keep a history, each given the same history as its documentation advises."""
