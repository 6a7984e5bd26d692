"""What is on a bus, in words: the decoder, and everything that is made of recorded frames."""
