// An independent subscriber: Fast DDS with its own CDR reader, as ROS 2's default middleware has it.
// Prints what arrives on rt/NAME/contacts, /image and /wrench as lines of JSON; ends when it has seen COUNT of each.
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <mutex>
#include <string>
#include <thread>

#include <fastcdr/Cdr.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;

struct Raw : TopicDataType {  // hands the bytes on; what they mean is read below, with Fast CDR
    explicit Raw(const char* name) {
        setName(name);
        m_typeSize = 1 << 20;
        m_isGetKeyDefined = false;
    }
    bool serialize(void*, SerializedPayload_t*) override { return false; }
    bool deserialize(SerializedPayload_t* payload, void* data) override {
        static_cast<std::string*>(data)->assign(reinterpret_cast<char*>(payload->data), payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void*) override { return [] { return 0u; }; }
    void* createData() override { return new std::string; }
    void deleteData(void* data) override { delete static_cast<std::string*>(data); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

struct Header {
    int32_t sec;
    uint32_t nanosec;
    std::string frame;
    explicit Header(Cdr& cdr) { cdr >> sec >> nanosec >> frame; }
};

static void contacts(Cdr& cdr) {
    Header header(cdr);
    uint64_t boot, sequence;
    uint32_t count;
    cdr >> boot >> sequence >> count;
    printf("{\"topic\": \"contacts\", \"stamp\": %lld, \"boot\": %llu, \"sequence\": %llu, \"patches\": [",
           header.sec * 1000000000LL + header.nanosec, (unsigned long long)boot, (unsigned long long)sequence);
    for (uint32_t k = 0; k < count; ++k) {
        std::string name, frame, mode;
        int32_t sec;
        uint32_t nanosec;
        uint64_t number;
        cdr >> name >> frame >> sec >> nanosec >> number >> mode;
        printf("%s[\"%s\", \"%s\", %lld, \"%s\"]", k ? ", " : "", name.c_str(), frame.c_str(), sec * 1000000000LL + nanosec, mode.c_str());
    }
    cdr >> count;
    printf("], \"contacts\": [");
    for (uint32_t k = 0; k < count; ++k) {
        uint32_t patch;
        int32_t id;
        double v[24];
        cdr >> patch >> id;
        for (double& value : v) cdr >> value;
        printf("%s[%u, %d, %.17g, %.17g, %.17g, %.17g, %.17g]", k ? ", " : "", patch, id, v[0], v[1], v[2], v[6], v[7]);
    }
    printf("]}\n");
}

static void image(Cdr& cdr) {
    Header header(cdr);
    uint32_t height, width, step, length;
    std::string encoding;
    uint8_t big;
    cdr >> height >> width >> encoding >> big >> step >> length;
    double sum = 0;
    std::string bytes(length, '\0');
    cdr.deserializeArray(reinterpret_cast<uint8_t*>(&bytes[0]), length);
    for (uint32_t k = 0; k < length / 4; ++k) {
        float pixel;
        memcpy(&pixel, bytes.data() + 4 * k, 4);
        if (pixel == pixel) sum += pixel;
    }
    printf("{\"topic\": \"image\", \"frame\": \"%s\", \"height\": %u, \"width\": %u, \"encoding\": \"%s\", \"step\": %u, \"sum\": %.9g}\n",
           header.frame.c_str(), height, width, encoding.c_str(), step, sum);
}

static void wrench(Cdr& cdr) {
    Header header(cdr);
    double v[6];
    for (double& value : v) cdr >> value;
    printf("{\"topic\": \"wrench\", \"frame\": \"%s\", \"force\": [%.17g, %.17g, %.17g], \"torque\": [%.17g, %.17g, %.17g]}\n",
           header.frame.c_str(), v[0], v[1], v[2], v[3], v[4], v[5]);
}

std::mutex lines;  // each topic has a thread of its own, and lines come whole

struct Listener : DataReaderListener {
    void (*print)(Cdr&);
    std::atomic<int> seen{0};
    explicit Listener(void (*how)(Cdr&)) : print(how) {}
    void on_data_available(DataReader* reader) override {
        std::string bytes;
        SampleInfo info;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            FastBuffer buffer(&bytes[0], bytes.size());
            Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
            cdr.read_encapsulation();
            std::lock_guard<std::mutex> lock(lines);
            print(cdr);
            fflush(stdout);
            ++seen;
        }
    }
};

int main(int argc, char** argv) {
    if (argc != 3) return 2;
    const std::string prefix = argv[1];
    const int wanted = atoi(argv[2]);
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    // Loopback only, and without multicast: the sender's machine is named, as on a network that forbids multicast.
    auto transport = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    transport->interfaceWhiteList.push_back("127.0.0.1");
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(transport);
    eprosima::fastrtps::rtps::Locator_t peer;
    eprosima::fastrtps::rtps::IPLocator::setIPv4(peer, "127.0.0.1");
    for (uint32_t number = 0; number < 4; ++number) {
        peer.port = 7410 + 2 * number;
        qos.wire_protocol().builtin.initialPeersList.push_back(peer);
    }
    auto* participant = DomainParticipantFactory::get_instance()->create_participant(0, qos);
    auto* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    struct {
        const char *name, *type;
        Listener listener;
        bool reliable;
    } topics[] = {{"contacts", "ohmskin_msgs::msg::dds_::Contacts_", Listener(contacts), true},
                  {"image", "sensor_msgs::msg::dds_::Image_", Listener(image), false},
                  {"wrench", "geometry_msgs::msg::dds_::WrenchStamped_", Listener(wrench), true}};
    for (auto& topic : topics) {
        TypeSupport type(new Raw(topic.type));
        type.register_type(participant);
        auto* own = participant->create_topic("rt" + prefix + "/" + topic.name, topic.type, TOPIC_QOS_DEFAULT);
        DataReaderQos how = DATAREADER_QOS_DEFAULT;
        how.reliability().kind = topic.reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
        subscriber->create_datareader(own, how, &topic.listener);
    }
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    auto done = [&] { for (auto& topic : topics) if (topic.listener.seen < wanted) return false; return true; };
    while (!done() && std::chrono::steady_clock::now() < end) std::this_thread::sleep_for(std::chrono::milliseconds(20));
    std::lock_guard<std::mutex> lock(lines);
    _Exit(done() ? 0 : 1);
}
