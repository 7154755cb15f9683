"""Contact mechanics with error certificates: scenes, runs, studies and the command line."""
