"""Job files: what they may say, and what is wrong with those that cannot run."""
