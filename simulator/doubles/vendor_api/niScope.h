/* Entry points of NI-SCOPE that the double answers; `entry_points.py` reads them, see nidaqmx.h.
 *
 * Names and order of the parameters are those of NI's header niScope.h, which the `niscope` package calls. What
 * the package can call but no driver of ours needs is left out. UINT32_MAX: a room that the caller has asked
 * for before (niScope_ActualNumWfms). */

int32_t niScope_SetRuntimeEnvironment(const char *environment, const char *environment_version,
    const char *reserved1, const char *reserved2);
int32_t niScope_InitWithOptions(const char *resource_name, uint16_t id_query, uint16_t reset_device,
    const char *option_string, uint32_t *vi);
int32_t niScope_close(uint32_t vi);
int32_t niScope_LockSession(uint32_t vi, void *caller_has_lock);
int32_t niScope_UnlockSession(uint32_t vi, void *caller_has_lock);
int32_t niScope_GetError(uint32_t vi, int32_t *error_code, int32_t buffer_size,
    char description[buffer_size]);
int32_t niScope_error_message(uint32_t vi, int32_t error_code, char error_message[256]);
int32_t niScope_GetChannelNameFromString(uint32_t vi, const char *indices, int32_t buffer_size,
    char names[buffer_size]);
int32_t niScope_GetAttributeViInt32(uint32_t vi, const char *channel_list, uint32_t attribute_id,
    int32_t *value);
int32_t niScope_GetAttributeViReal64(uint32_t vi, const char *channel_list, uint32_t attribute_id,
    double *value);
int32_t niScope_GetAttributeViString(uint32_t vi, const char *channel_list, uint32_t attribute_id,
    int32_t buf_size, char value[buf_size]);
int32_t niScope_SetAttributeViBoolean(uint32_t vi, const char *channel_list, uint32_t attribute_id,
    uint16_t value);
int32_t niScope_SetAttributeViInt32(uint32_t vi, const char *channel_list, uint32_t attribute_id,
    int32_t value);
int32_t niScope_ConfigureVertical(uint32_t vi, const char *channel_list, double range, double offset,
    int32_t coupling, double probe_attenuation, uint16_t enabled);
int32_t niScope_ConfigureChanCharacteristics(uint32_t vi, const char *channel_list, double input_impedance,
    double max_input_frequency);
int32_t niScope_ConfigureHorizontalTiming(uint32_t vi, double min_sample_rate, int32_t min_num_pts,
    double ref_position, int32_t num_records, uint16_t enforce_realtime);
int32_t niScope_ConfigureTriggerEdge(uint32_t vi, const char *trigger_source, double level, int32_t slope,
    int32_t trigger_coupling, double holdoff, double delay);
int32_t niScope_ConfigureTriggerDigital(uint32_t vi, const char *trigger_source, int32_t slope,
    double holdoff, double delay);
int32_t niScope_Commit(uint32_t vi);
int32_t niScope_InitiateAcquisition(uint32_t vi);
int32_t niScope_Abort(uint32_t vi);
int32_t niScope_ActualNumWfms(uint32_t vi, const char *channel_list, int32_t *num_wfms);
/* Samples of all records one after the other, and one niScope_wfmInfo a record. */
int32_t niScope_FetchBinary16(uint32_t vi, const char *channel_list, double timeout, int32_t num_samples,
    int16_t waveform[UINT32_MAX], uint8_t wfm_info[UINT32_MAX]);
int32_t niScope_ResetDevice(uint32_t vi);
int32_t niScope_CalFetchDate(uint32_t vi, int32_t which_one, int32_t *year, int32_t *month, int32_t *day);
int32_t niScope_CalFetchTemperature(uint32_t vi, int32_t which_one, double *temperature);
int32_t niScope_CalSelfCalibrate(uint32_t vi, const char *channel_list, int32_t option);
