// A Cyclone DDS participant configured as rmw_cyclonedds does it, with types of its own compiler.
// Arguments, standard input and output: as ros2_fast_dds.cpp; the sequence is not known here: 0.
// Samples come and go as CDR, which Cyclone checks against its type in both directions.
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "dds/dds.h"
#include "dds/ddsi/ddsi_serdata.h"
#include "types.h"

struct named {
  const char* name;
  const dds_topic_descriptor_t* type;
};
static const struct named TYPES[] = {
#include "table.h"
};

enum { MOST = 64, LARGEST = 65536 };
static pthread_mutex_t out = PTHREAD_MUTEX_INITIALIZER;
static dds_entity_t writers[MOST];
static const struct ddsi_sertype* wire[MOST];

static const dds_topic_descriptor_t* type_of(const char* name) {
  for (size_t i = 0; i < sizeof TYPES / sizeof *TYPES; ++i)
    if (strcmp(TYPES[i].name, name) == 0) return TYPES[i].type;
  fprintf(stderr, "no type %s\n", name);
  exit(2);
}

static void show(dds_entity_t reader, void* number) {
  struct ddsi_serdata* data;
  dds_sample_info_t info;
  while (dds_takecdr(reader, &data, 1, &info, DDS_ANY_STATE) == 1) {
    if (info.valid_data) {
      uint32_t size = ddsi_serdata_size(data);
      unsigned char* cdr = malloc(size);
      ddsi_serdata_to_ser(data, 0, size, cdr);
      pthread_mutex_lock(&out);
      printf("%d %lld 0 ", (int)(intptr_t)number, (long long)(dds_time() - info.source_timestamp));
      for (uint32_t i = 0; i < size; ++i) printf("%02x", cdr[i]);
      printf("\n");
      fflush(stdout);
      pthread_mutex_unlock(&out);
      free(cdr);
    }
    ddsi_serdata_unref(data);
  }
}

// How Cyclone carries a type is only seen on a sample: write one to ourselves.
static const struct ddsi_sertype* wire_of(dds_entity_t node, const dds_topic_descriptor_t* type,
                                          const dds_qos_t* qos, int number) {
  char name[32];
  snprintf(name, sizeof name, "types/%d", number);
  dds_entity_t topic = dds_create_topic(node, type, name, NULL, NULL);
  dds_entity_t reader = dds_create_reader(node, topic, qos, NULL);
  dds_entity_t writer = dds_create_writer(node, topic, qos, NULL);
  struct ddsi_serdata* data;
  dds_sample_info_t info;
  void* empty = calloc(1, type->m_size);
  if (dds_write(writer, empty) != 0 || dds_takecdr(reader, &data, 1, &info, DDS_ANY_STATE) != 1) {
    fprintf(stderr, "no sample of %s\n", type->m_typename);
    exit(2);
  }
  return data->type;  // which lives as long as the topic and this sample
}

static void write_cdr(int number, const char* hex) {
  unsigned char cdr[LARGEST];
  size_t size = strlen(hex) / 2;
  if (size > sizeof cdr) exit(2);
  for (size_t i = 0; i < size; ++i) {
    unsigned byte;
    sscanf(hex + 2 * i, "%2x", &byte);
    cdr[i] = byte;
  }
  ddsrt_iovec_t part = {.iov_base = cdr, .iov_len = size};
  struct ddsi_serdata* data = ddsi_serdata_from_ser_iov(wire[number], SDK_DATA, 1, &part, size);
  if (data == NULL) {
    fprintf(stderr, "endpoint %d: this is no sample of its type\n", number);
    return;
  }
  dds_writecdr(writers[number], data);
}

int main(int argc, char** argv) {
  const char* settings =
      "<CycloneDDS><Domain Id=\"any\"><General><Interfaces><NetworkInterface name=\"lo\""
      " multicast=\"false\"/></Interfaces><AllowMulticast>false</AllowMulticast></General>"
      "<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address=\"127.0.0.1\"/>"
      "</Peers></Discovery></Domain></CycloneDDS>";
  dds_domainid_t domain = (dds_domainid_t)atoi(argv[1]);
  dds_create_domain(domain, settings);
  dds_entity_t node = dds_create_participant(domain, NULL, NULL);
  if (node < 0) return 3;
  for (int i = 2, number = 0; i + 3 < argc && number < MOST; i += 4, ++number) {
    const dds_topic_descriptor_t* type = type_of(argv[i + 2]);
    int reliable = strcmp(argv[i + 3], "reliable") == 0;
    dds_qos_t* qos = dds_create_qos();
    dds_qset_reliability(qos, reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
                         DDS_SECS(1));
    dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, reliable ? 1000 : 10);
    dds_entity_t topic = dds_create_topic(node, type, argv[i + 1], NULL, NULL);
    if (argv[i][0] == 'w') {
      wire[number] = wire_of(node, type, qos, number);
      writers[number] = dds_create_writer(node, topic, qos, NULL);
    } else {
      dds_listener_t* listener = dds_create_listener((void*)(intptr_t)number);
      dds_lset_data_available(listener, show);
      dds_create_reader(node, topic, qos, listener);
      dds_delete_listener(listener);
    }
    dds_delete_qos(qos);
  }
  for (int number = 0; number < MOST; ++number) {
    dds_publication_matched_status_t status = {0};
    while (writers[number] > 0 &&
           dds_get_publication_matched_status(writers[number], &status) == DDS_RETCODE_OK &&
           status.current_count == 0)
      dds_sleepfor(DDS_MSECS(10));
  }
  pthread_mutex_lock(&out);
  printf("ready\n");
  fflush(stdout);
  pthread_mutex_unlock(&out);
  static char line[2 * LARGEST], hex[2 * LARGEST];
  while (fgets(line, sizeof line, stdin) != NULL) {
    int number, count = 1;
    long long period_us = 0;
    if (sscanf(line, "%d %s %d %lld", &number, hex, &count, &period_us) < 2) continue;
    dds_time_t due = dds_time();
    for (int i = 0; i < count; ++i) {
      write_cdr(number, hex);
      due += DDS_USECS(period_us);
      if (period_us > 0 && due > dds_time()) dds_sleepfor(due - dds_time());
    }
  }
  dds_delete(DDS_CYCLONEDDS_HANDLE);
  return 0;
}
