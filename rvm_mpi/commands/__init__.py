"""The commands of `rvm`: they parse and print."""
