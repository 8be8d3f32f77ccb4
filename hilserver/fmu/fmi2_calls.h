/* The functions of FMI 2.0; included by robot_fmu.c. */
const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging) {
    if (type != fmi2CoSimulation) return NULL;
    if (functions == NULL) return make(name, guid, NULL, NULL);
    return make(name, guid, functions->logger, functions->componentEnvironment);
}
Status fmi2SetupExperiment(Handle c, fmi2Boolean tolerance_defined, double tolerance, double start,
                           fmi2Boolean stop_defined, double stop) {
    return begin_at(c, start);
}
Status fmi2EnterInitializationMode(Handle c) { return OK; }
Status fmi2SetDebugLogging(Handle c, fmi2Boolean on, size_t n, const fmi2String categories[]) {
    return OK;
}
Status fmi2SetReal(Handle c, const Reference vr[], size_t n, const double v[]) {
    return set_all(c, vr, n, v);
}
Status fmi2GetReal(Handle c, const Reference vr[], size_t n, double v[]) {
    return get_all(c, vr, n, v);
}
Status fmi2DoStep(Handle c, double time, double dt, fmi2Boolean no_set) { return step(c, time, dt); }
Status fmi2GetFMUstate(Handle c, Saved *s) { return save(c, s); }
Status fmi2SetFMUstate(Handle c, Saved s) { return restore(c, s); }
Status fmi2FreeFMUstate(Handle c, Saved *s) {
    free(*s);
    *s = NULL;
    return OK;
}
Status fmi2SerializedFMUstateSize(Handle c, Saved s, size_t *n) {
    *n = sizeof(State);
    return OK;
}
Status fmi2SerializeFMUstate(Handle c, Saved s, fmi2Byte b[], size_t n) {
    if (n < sizeof(State)) return refuse(c, "a state has %zu bytes", sizeof(State));
    memcpy(b, s, sizeof(State));
    return OK;
}
Status fmi2DeSerializeFMUstate(Handle c, const fmi2Byte b[], size_t n, Saved *s) {
    return unpack(c, b, n, s);
}

/* What this model has not; the first arguments are enough to say so. */
#define NO_VARIABLE(name) \
    Status fmi2##name(Handle c, const Reference vr[], size_t n) { \
        return n == 0 ? OK : refuse(c, "fmi2" #name ": all variables are Real"); \
    }
NO_VARIABLE(SetInteger) NO_VARIABLE(GetInteger) NO_VARIABLE(SetBoolean) NO_VARIABLE(GetBoolean)
NO_VARIABLE(SetString) NO_VARIABLE(GetString)
#define NOT(name) \
    Status fmi2##name(Handle c) { return refuse(c, "fmi2" #name " is not supported by this model"); }
NOT(SetRealInputDerivatives) NOT(GetRealOutputDerivatives) NOT(GetDirectionalDerivative)
NOT(CancelStep) NOT(GetStatus) NOT(GetRealStatus) NOT(GetIntegerStatus) NOT(GetBooleanStatus)
NOT(GetStringStatus)
