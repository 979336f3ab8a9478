"""What else one could keep a history in: each peer told the same history in the way that its documentation advises."""
