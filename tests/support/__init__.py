"""What tests share: oracles, files written by hand, processes to be killed, a browser's visitor."""
