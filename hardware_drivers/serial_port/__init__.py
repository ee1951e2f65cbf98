"""Instruments with a text protocol: the electrochemical power supply and the climate probe.

They stand at the end of one `line`, whatever carries it (`port`: a serial port, a TCP socket, a VISA
resource); what a supply is sent comes from a table (`dialects`). `parameters` and `dialects` are light;
`port` imports pyserial, `visa_port` pyvisa, and only they do.
"""
