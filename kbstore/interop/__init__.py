"""Other libraries' views of a knowledge base; each is imported when it is first used."""
