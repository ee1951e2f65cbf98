/* Entry points of NI-DAQmx that the double answers; `entry_points.py` reads them.
 *
 * Names of parameters are those of `nidaqmx` and of the NI-DAQmx gRPC messages. `name[size]` is an array with
 * room for so many elements, another parameter or a constant; const: an input. `void *`: reserved. A variable
 * list ends an entry about an attribute (its value and, for text and arrays, the room; see attributes.csv) and
 * those about power-up states (pairs of channel and state, ended by NULL). */

int32_t DAQmxSetRuntimeEnvironment(const char *environment, const char *environment_version,
    const char *reserved_1, const char *reserved_2);
int32_t DAQmxGetErrorString(int32_t error_code, char error_string[buffer_size], uint32_t buffer_size);

/* Tasks */
int32_t DAQmxCreateTask(const char *session_name, TaskHandle *task);
int32_t DAQmxClearTask(TaskHandle task);
int32_t DAQmxTaskControl(TaskHandle task, int32_t action);
int32_t DAQmxStartTask(TaskHandle task);
int32_t DAQmxStopTask(TaskHandle task);
int32_t DAQmxWaitUntilTaskDone(TaskHandle task, double time_to_wait);

/* Channels */
int32_t DAQmxCreateAIVoltageChan(TaskHandle task, const char *physical_channel,
    const char *name_to_assign_to_channel, int32_t terminal_config, double min_val, double max_val,
    int32_t units, const char *custom_scale_name);
int32_t DAQmxCreateCOPulseChanTime(TaskHandle task, const char *counter,
    const char *name_to_assign_to_channel, int32_t units, int32_t idle_state, double initial_delay,
    double low_time, double high_time);
int32_t DAQmxInternalGetLastCreatedChan(char value[size], uint32_t size);

/* Timing and triggers */
int32_t DAQmxCfgSampClkTiming(TaskHandle task, const char *source, double rate, int32_t active_edge,
    int32_t sample_mode, uint64_t samps_per_chan);
int32_t DAQmxCfgAnlgEdgeRefTrig(TaskHandle task, const char *trigger_source, int32_t trigger_slope,
    double trigger_level, uint32_t pretrigger_samples);
int32_t DAQmxCfgDigEdgeStartTrig(TaskHandle task, const char *trigger_source, int32_t trigger_edge);
int32_t DAQmxDisableRefTrig(TaskHandle task);
int32_t DAQmxDisableStartTrig(TaskHandle task);
int32_t DAQmxExportSignal(TaskHandle task, int32_t signal_id, const char *output_terminal);

/* Reading */
int32_t DAQmxReadBinaryI16(TaskHandle task, int32_t num_samps_per_chan, double timeout, int32_t fill_mode,
    int16_t read_array[array_size_in_samps], uint32_t array_size_in_samps, int32_t *samps_per_chan_read,
    void *reserved);
int32_t DAQmxReadBinaryI32(TaskHandle task, int32_t num_samps_per_chan, double timeout, int32_t fill_mode,
    int32_t read_array[array_size_in_samps], uint32_t array_size_in_samps, int32_t *samps_per_chan_read,
    void *reserved);

/* Devices, terminals, calibration */
int32_t DAQmxResetDevice(const char *device_name);
int32_t DAQmxSelfCal(const char *device_name);
int32_t DAQmxGetSelfCalLastDateAndTime(const char *device_name, uint32_t *year, uint32_t *month,
    uint32_t *day, uint32_t *hour, uint32_t *minute);
int32_t DAQmxConnectTerms(const char *source_terminal, const char *destination_terminal,
    int32_t signal_modifiers);
int32_t DAQmxDisconnectTerms(const char *source_terminal, const char *destination_terminal);
int32_t DAQmxTristateOutputTerm(const char *output_terminal);
int32_t DAQmxSetDigitalPowerUpStates(const char *device_name, ...);
int32_t DAQmxGetDigitalPowerUpStates(const char *device_name, ...);

/* Watchdog */
int32_t DAQmxCreateWatchdogTimerTaskEx(const char *device_name, const char *session_name, TaskHandle *task,
    double timeout);
int32_t DAQmxCfgWatchdogDOExpirStates(TaskHandle task, const char *channel_names,
    const int32_t expir_state_array[array_size], uint32_t array_size);
int32_t DAQmxControlWatchdogTask(TaskHandle task, int32_t action);

/* Attributes */
int32_t DAQmxGetTaskAttribute(TaskHandle task, int32_t attribute, ...);
int32_t DAQmxGetDeviceAttribute(const char *device_name, int32_t attribute, ...);
int32_t DAQmxGetSystemInfoAttribute(int32_t attribute, ...);
int32_t DAQmxGetCalInfoAttribute(const char *device_name, int32_t attribute, ...);
int32_t DAQmxGetChanAttribute(TaskHandle task, const char *channel, int32_t attribute, ...);
int32_t DAQmxSetChanAttribute(TaskHandle task, const char *channel, int32_t attribute, ...);
int32_t DAQmxGetTimingAttribute(TaskHandle task, int32_t attribute, ...);
int32_t DAQmxSetTimingAttribute(TaskHandle task, int32_t attribute, ...);
int32_t DAQmxGetTrigAttribute(TaskHandle task, int32_t attribute, ...);
int32_t DAQmxSetTrigAttribute(TaskHandle task, int32_t attribute, ...);
int32_t DAQmxGetReadAttribute(TaskHandle task, int32_t attribute, ...);
int32_t DAQmxGetWatchdogAttribute(TaskHandle task, const char *lines, int32_t attribute, ...);
