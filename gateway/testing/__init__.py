"""For test suites of others: a bench in a fixture, flags to expect, scenario files as tests."""
