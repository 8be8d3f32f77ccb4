/* The functions of FMI 3.0; included by robot_fmu.c. */
fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources,
                                         fmi3Boolean visible, fmi3Boolean logging,
                                         fmi3Boolean events, fmi3Boolean early,
                                         const Reference required[], size_t n,
                                         fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log,
                                         fmi3IntermediateUpdateCallback update) {
    return make(name, token, log, environment);
}
fmi3Instance fmi3InstantiateModelExchange(void) { return NULL; }
fmi3Instance fmi3InstantiateScheduledExecution(void) { return NULL; }

Status fmi3EnterInitializationMode(Handle c, fmi3Boolean tolerance_defined, double tolerance,
                                   double start, fmi3Boolean stop_defined, double stop) {
    return begin_at(c, start);
}
Status fmi3SetDebugLogging(Handle c, fmi3Boolean on, size_t n, const fmi3String categories[]) {
    return OK;
}
Status fmi3SetFloat64(Handle c, const Reference vr[], size_t n, const double v[], size_t n_values) {
    return set_all(c, vr, n, v);
}
Status fmi3GetFloat64(Handle c, const Reference vr[], size_t n, double v[], size_t n_values) {
    return get_all(c, vr, n, v);
}
Status fmi3DoStep(Handle c, double time, double dt, fmi3Boolean no_set, fmi3Boolean *event,
                  fmi3Boolean *terminate, fmi3Boolean *early, double *last) {
    Status status = step(c, time, dt);
    *event = *terminate = *early = fmi3False;
    *last = status == OK ? time + dt : time;
    return status;
}
Status fmi3GetFMUState(Handle c, Saved *s) { return save(c, s); }
Status fmi3SetFMUState(Handle c, Saved s) { return restore(c, s); }
Status fmi3FreeFMUState(Handle c, Saved *s) {
    free(*s);
    *s = NULL;
    return OK;
}
Status fmi3SerializedFMUStateSize(Handle c, Saved s, size_t *n) {
    *n = sizeof(State);
    return OK;
}
Status fmi3SerializeFMUState(Handle c, Saved s, fmi3Byte b[], size_t n) {
    if (n < sizeof(State)) return refuse(c, "a state has %zu bytes", sizeof(State));
    memcpy(b, s, sizeof(State));
    return OK;
}
Status fmi3DeserializeFMUState(Handle c, const fmi3Byte b[], size_t n, Saved *s) {
    return unpack(c, b, n, s);
}

/* What this model has not. Importers refuse a library that lacks one of them; the first argument is
 * enough to say so. */
#define NOT(name) \
    Status fmi3##name(Handle c) { return refuse(c, "fmi3" #name " is not supported by this model"); }
NOT(EnterEventMode) NOT(GetFloat32) NOT(GetInt8) NOT(GetUInt8) NOT(GetInt16) NOT(GetUInt16)
NOT(GetInt32) NOT(GetUInt32) NOT(GetInt64) NOT(GetUInt64) NOT(GetBoolean) NOT(GetString)
NOT(GetBinary) NOT(GetClock) NOT(SetFloat32) NOT(SetInt8) NOT(SetUInt8) NOT(SetInt16) NOT(SetUInt16)
NOT(SetInt32) NOT(SetUInt32) NOT(SetInt64) NOT(SetUInt64) NOT(SetBoolean) NOT(SetString)
NOT(SetBinary) NOT(SetClock) NOT(GetNumberOfVariableDependencies) NOT(GetVariableDependencies)
NOT(GetDirectionalDerivative) NOT(GetAdjointDerivative) NOT(EnterConfigurationMode)
NOT(ExitConfigurationMode) NOT(GetIntervalDecimal) NOT(GetIntervalFraction) NOT(GetShiftDecimal)
NOT(GetShiftFraction) NOT(SetIntervalDecimal) NOT(SetIntervalFraction) NOT(SetShiftDecimal)
NOT(SetShiftFraction) NOT(EvaluateDiscreteStates) NOT(UpdateDiscreteStates)
NOT(EnterContinuousTimeMode) NOT(CompletedIntegratorStep) NOT(SetTime) NOT(SetContinuousStates)
NOT(GetContinuousStateDerivatives) NOT(GetEventIndicators) NOT(GetContinuousStates)
NOT(GetNominalsOfContinuousStates) NOT(GetNumberOfEventIndicators) NOT(GetNumberOfContinuousStates)
NOT(EnterStepMode) NOT(GetOutputDerivatives) NOT(ActivateModelPartition)
