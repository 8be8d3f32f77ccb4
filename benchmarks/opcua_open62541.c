/* open62541's server with Doubles that change at a fixed rate: a reference of `bench opcua`.

   opcua_open62541 PORT NODES RATE_HZ prints a line once it listens, and serves until its standard
   input ends. */
#include <open62541/server.h>
#include <open62541/server_config_default.h>

#include <poll.h>
#include <stdio.h>
#include <stdlib.h>

static size_t nodes;
static double count;

static UA_NodeId node(size_t number, char *text, size_t size) {
    snprintf(text, size, "n%zu", number);
    return UA_NODEID_STRING(1, text);
}

static void change(UA_Server *server, void *data) {
    (void)data;
    count += 1.0;
    for (size_t i = 0; i < nodes; i++) {
        char text[32];
        UA_Double value = count + (double)i;
        UA_DataValue sample;
        UA_DataValue_init(&sample);
        UA_Variant_setScalar(&sample.value, &value, &UA_TYPES[UA_TYPES_DOUBLE]);
        sample.sourceTimestamp = UA_DateTime_now();
        sample.hasValue = sample.hasSourceTimestamp = true;
        UA_Server_writeDataValue(server, node(i, text, sizeof text), sample);
    }
}

static void add(UA_Server *server, size_t number) {
    char text[32];
    UA_NodeId id = node(number, text, sizeof text);
    UA_VariableAttributes attributes = UA_VariableAttributes_default;
    UA_Double zero = 0.0;
    UA_Variant_setScalar(&attributes.value, &zero, &UA_TYPES[UA_TYPES_DOUBLE]);
    attributes.dataType = UA_TYPES[UA_TYPES_DOUBLE].typeId;
    attributes.valueRank = UA_VALUERANK_SCALAR;
    UA_StatusCode status = UA_Server_addVariableNode(
        server, id, UA_NODEID_NUMERIC(0, UA_NS0ID_OBJECTSFOLDER),
        UA_NODEID_NUMERIC(0, UA_NS0ID_ORGANIZES), UA_QUALIFIEDNAME(1, text),
        UA_NODEID_NUMERIC(0, UA_NS0ID_BASEDATAVARIABLETYPE), attributes, NULL, NULL);
    if (status != UA_STATUSCODE_GOOD) {
        fprintf(stderr, "%s: %s\n", text, UA_StatusCode_name(status));
        exit(1);
    }
}

int main(int argc, char **argv) {
    if (argc != 4) {
        fprintf(stderr, "usage: %s PORT NODES RATE_HZ\n", argv[0]);
        return 2;
    }
    UA_Server *server = UA_Server_new();
    UA_ServerConfig *config = UA_Server_getConfig(server);
    UA_ServerConfig_setMinimal(config, (UA_UInt16)atoi(argv[1]), NULL);
    config->publishingIntervalLimits.min = 5.0;
    /* 0: a monitored item takes what is written, when it is written */
    config->samplingIntervalLimits.min = 0.0;

    nodes = (size_t)atoi(argv[2]);
    for (size_t i = 0; i < nodes; i++) add(server, i);
    UA_Server_addRepeatedCallback(server, change, NULL, 1e3 / atof(argv[3]), NULL);
    if (UA_Server_run_startup(server) != UA_STATUSCODE_GOOD) return 1;
    puts("ready");
    fflush(stdout);

    struct pollfd input = {.fd = 0, .events = POLLIN};
    while (poll(&input, 1, 0) == 0) UA_Server_run_iterate(server, true);
    UA_Server_run_shutdown(server);
    UA_Server_delete(server);
    return 0;
}
