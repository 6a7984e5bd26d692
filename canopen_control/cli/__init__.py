"""Command line interface; each verb has a module of its own, which is imported when the verb is used."""
