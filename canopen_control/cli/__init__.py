"""Command line interface; the module of each verb is imported only when the verb is used."""
