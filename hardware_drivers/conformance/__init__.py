"""Conformance suites: rules for every instrument, as tests for a laboratory's own driver.

A plugin of pytest (`plugin`) gives the command its options; nothing else of solimon imports pytest::

    pytest --pyargs hardware_drivers.conformance --solimon-kind my-scope --solimon-config rig.toml

``docs/how-to/write-a-driver.md`` leads through it. A suite is also a class that a test file of one's own
may inherit: it asks for the instrument by fixtures, which the heir gives.
"""
