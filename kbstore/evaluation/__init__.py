"""Whether conditions hold and what expressions come to, at a moment and over a span; pure, without a database."""
