"""Studies: programs that measure this application or reproduce tables and figures of the paper."""
