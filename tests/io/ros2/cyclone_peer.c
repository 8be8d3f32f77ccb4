// A Cyclone DDS participant, configured as rmw_cyclonedds does it: drives by rpm until the wheels
// turn, then disables the drive by a service whose identity stands in the message, and checks the
// answer. Argument: the domain. Exit code 0: everything came.
#include <stdio.h>
#include <stdlib.h>

#include "dds/dds.h"
#include "types.h"

typedef iotbot_interface_msg_dds__RotationSpeed_ Speed;
typedef iotbot_interface_srv_dds__SendEnable_Request_ Request;
typedef iotbot_interface_srv_dds__SendEnable_Response_ Response;

static const uint64_t GUID = 0x0123456789abcdefu;
static const int PATIENCE = 6000;  // times 10 ms

static dds_entity_t topic(dds_entity_t node, const dds_topic_descriptor_t* type, const char* name) {
  return dds_create_topic(node, type, name, NULL, NULL);
}

static int take(dds_entity_t reader, void* sample) {
  dds_sample_info_t info;
  void* samples[1] = {sample};
  return dds_take(reader, samples, &info, 1, 1) == 1 && info.valid_data;
}

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  const char* settings =
      "<CycloneDDS><Domain Id=\"any\"><General><Interfaces><NetworkInterface name=\"lo\""
      " multicast=\"false\"/></Interfaces><AllowMulticast>false</AllowMulticast></General>"
      "<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address=\"127.0.0.1\"/>"
      "</Peers></Discovery></Domain></CycloneDDS>";
  dds_domainid_t domain = (dds_domainid_t)atoi(argv[1]);
  dds_create_domain(domain, settings);
  dds_entity_t node = dds_create_participant(domain, NULL, NULL);
  if (node < 0) return 3;
  dds_qos_t* qos = dds_create_qos();
  dds_qset_reliability(qos, DDS_RELIABILITY_RELIABLE, DDS_SECS(1));
  dds_qset_history(qos, DDS_HISTORY_KEEP_LAST, 10);
  const dds_topic_descriptor_t* speed = &iotbot_interface_msg_dds__RotationSpeed__desc;
  dds_entity_t target = dds_create_writer(node, topic(node, speed, "rt/iotbot/rpm"), qos, NULL);
  dds_entity_t wheels =
      dds_create_reader(node, topic(node, speed, "rt/iotbot/rpm/return"), qos, NULL);
  dds_entity_t calls = dds_create_writer(
      node,
      topic(node, &iotbot_interface_srv_dds__SendEnable_Request__desc,
            "rq/iotbot/srv/send_enableRequest"),
      qos, NULL);
  dds_entity_t answers = dds_create_reader(
      node,
      topic(node, &iotbot_interface_srv_dds__SendEnable_Response__desc,
            "rr/iotbot/srv/send_enableReply"),
      qos, NULL);
  Speed wanted = {50, -50, 50, -50}, seen = {0, 0, 0, 0};
  Request request = {GUID, 7, 0};
  Response response = {0, 0, 0};
  int answered = 0;
  for (int i = 0; i < PATIENCE; ++i) {
    dds_write(target, &wanted);
    dds_sleepfor(DDS_MSECS(10));
    while (take(wheels, &seen)) {
    }
    if (!answered && seen.front_left_rpm > 49 && seen.rear_right_rpm < -49) {
      if (request.sequence_number == 7) dds_write(calls, &request);
      ++request.sequence_number;  // once
    }
    if (take(answers, &response)) answered = 1;
    if (answered && seen.front_left_rpm < 1) break;
  }
  printf("%f %llx %lld %d\n", seen.front_left_rpm, (unsigned long long)response.guid,
         (long long)response.sequence_number, (int)response.sending_succesfull);
  dds_delete_qos(qos);
  dds_delete(node);
  return !(answered && response.guid == GUID && response.sequence_number == 7 &&
           response.sending_succesfull && seen.front_left_rpm < 1);
}
