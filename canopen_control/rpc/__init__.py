"""The sockets of this package: what is said on them (`messages`), the server and its clients, all typed."""
