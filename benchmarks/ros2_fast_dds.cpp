// A Fast DDS participant configured as rmw_fastrtps does it: no type information, RELIABLE writers.
// Arguments: the domain, then for each endpoint r|w, topic, type, reliable|best_effort.
// Says "ready" when every writer has found a reader.
// Standard input: lines of "<endpoint> <hex> [<times> <period in us>]" to write; standard output:
// "<endpoint> <ns from written to here> <sequence of its writer> <hex>".
#include <chrono>
#include <cstring>
#include <iostream>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/publisher/qos/DataWriterQos.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/subscriber/qos/DataReaderQos.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::Locator_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using Bytes = std::vector<unsigned char>;

constexpr unsigned LARGEST = 65536;

// Carries CDR as it is: what the bytes mean is the test's affair.
class Carrier : public TopicDataType {
 public:
  explicit Carrier(const std::string& name) {
    setName(name.c_str());
    m_typeSize = LARGEST;
    m_isGetKeyDefined = false;
  }
  bool serialize(void* data, SerializedPayload_t* payload) override {
    auto* bytes = static_cast<Bytes*>(data);
    payload->encapsulation = CDR_LE;
    payload->length = bytes->size();
    std::memcpy(payload->data, bytes->data(), bytes->size());
    return true;
  }
  bool deserialize(SerializedPayload_t* payload, void* data) override {
    static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
    return true;
  }
  std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
    return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
  }
  void* createData() override { return new Bytes(); }
  void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
  bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

std::mutex out;

class Listener : public DataReaderListener {
 public:
  explicit Listener(int number) : number_(number) {}
  void on_data_available(DataReader* reader) override {
    Bytes bytes;
    SampleInfo info;
    while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      auto now = std::chrono::system_clock::now().time_since_epoch();
      auto late = std::chrono::duration_cast<std::chrono::nanoseconds>(now).count() -
                  info.source_timestamp.to_ns();
      std::ostringstream line;
      line << number_ << ' ' << late << ' '
           << info.sample_identity.sequence_number().to64long() << ' ' << std::hex;
      for (unsigned byte : bytes) line << (byte < 16 ? "0" : "") << byte;
      std::lock_guard<std::mutex> lock(out);
      std::cout << line.str() << std::endl;
    }
  }

 private:
  int number_;
};

int main(int argc, char** argv) {
  const int domain = std::stoi(argv[1]);
  DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
  qos.name("fast_dds_peer");
  qos.transport().use_builtin_transports = false;
  auto udp = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
  udp->interfaceWhiteList.emplace_back("127.0.0.1");
  udp->receiveBufferSize = 4 << 20;  // what comes while a busy computer lets us wait
  qos.transport().user_transports.push_back(udp);
  for (int id = 0; id < 8; ++id) {
    Locator_t peer;
    eprosima::fastrtps::rtps::IPLocator::setIPv4(peer, 127, 0, 0, 1);
    peer.port = 7400 + 250 * domain + 10 + 2 * id;
    qos.wire_protocol().builtin.initialPeersList.push_back(peer);
  }
  auto* participant = DomainParticipantFactory::get_instance()->create_participant(domain, qos);
  if (participant == nullptr) return 1;
  auto* publisher = participant->create_publisher(PUBLISHER_QOS_DEFAULT);
  auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  std::vector<DataWriter*> writers;
  for (int i = 2; i + 3 < argc; i += 4) {
    const int number = writers.size();
    const bool reads = argv[i][0] == 'r', reliable = std::string(argv[i + 3]) == "reliable";
    TypeSupport type(new Carrier(argv[i + 2]));
    type.register_type(participant);
    auto* topic = participant->create_topic(argv[i + 1], argv[i + 2], TOPIC_QOS_DEFAULT);
    writers.push_back(nullptr);
    if (reads) {
      DataReaderQos q = DATAREADER_QOS_DEFAULT;
      q.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
      q.history().depth = reliable ? 1000 : 10;
      q.endpoint().history_memory_policy =
          eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
      subscriber->create_datareader(topic, q, new Listener(number));
    } else {
      DataWriterQos q = DATAWRITER_QOS_DEFAULT;
      q.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
      q.history().depth = reliable ? 1000 : 10;
      q.endpoint().history_memory_policy =
          eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
      writers[number] = publisher->create_datawriter(topic, q);
    }
  }
  for (auto* writer : writers) {
    PublicationMatchedStatus status;
    while (writer != nullptr && writer->get_publication_matched_status(status) ==
                                    ReturnCode_t::RETCODE_OK && status.current_count == 0)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  {
    std::lock_guard<std::mutex> lock(out);
    std::cout << "ready" << std::endl;
  }
  std::string line;
  while (std::getline(std::cin, line)) {
    std::istringstream words(line);
    int number, times = 1, period_us = 0;
    std::string hex;
    words >> number >> hex;
    if (!words.eof()) words >> times >> period_us;
    Bytes bytes;
    for (size_t i = 0; i + 1 < hex.size(); i += 2)
      bytes.push_back(std::stoul(hex.substr(i, 2), nullptr, 16));
    auto due = std::chrono::steady_clock::now();
    for (int i = 0; i < times; ++i) {
      writers[number]->write(&bytes);
      due += std::chrono::microseconds(period_us);
      if (period_us > 0) std::this_thread::sleep_until(due);
    }
  }
  participant->delete_contained_entities();
  DomainParticipantFactory::get_instance()->delete_participant(participant);
  return 0;
}
