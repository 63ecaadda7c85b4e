// What an ohmskin tactile skin feels, for control loops in C++: reads the shared memory that
// `ohmskin live --publish shm` writes. One header, C++17, standard library and POSIX; Linux, little-endian.
// Neither side waits for the other; either may start, end and come again. Memory is allocated when a skin is seen
// for the first time or has started anew, at no other look. Threads need a Client each. More: docs/guide/publishing.md
#pragma once

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <array>
#include <cctype>
#include <cerrno>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <list>
#include <locale>
#include <map>
#include <memory>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#if !defined(__BYTE_ORDER__) || __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "ohmskin.hpp reads little-endian memory as it is; this machine is not little-endian"
#endif

namespace ohmskin {

// A board that cannot be used: of another version, not one's own, or of a name that is none.
struct Error : std::runtime_error { using std::runtime_error::runtime_error; };

using Vector = std::array<double, 3>;
using Matrix = std::array<Vector, 3>;

// Seconds on the clock of all times here, that of Python's time.monotonic().
inline double now() {
    timespec at{};
    clock_gettime(CLOCK_MONOTONIC, &at);
    return double(at.tv_sec) + 1e-9 * double(at.tv_nsec);
}

// One skin and where it sits: origin (m) and directions of x, y and z of the sheet in its frame.
struct Patch {
    std::string name, frame;
    Vector position;
    Matrix axes;
    bool newtons;  // whether its contacts tell their force: only if the skin was calibrated for that
};

// One place where the robot is touched; `patch` and `frame` are there as long as the client is.
struct PlacedContact {
    std::int32_t id;                         // stays while the contact lasts; counted by each patch for itself
    std::string_view patch, frame;           // name of the patch; the frame of all vectors here
    Vector position, normal;                 // m; outward
    double extent, strength;                 // m2, m2; strength is not a force, but grows with it
    double confidence, peak;                 // 0 to 1; largest relative conductivity change
    std::optional<double> radius;            // m; empty where it is not known, as all that follows
    std::optional<Vector> velocity;          // m/s
    std::optional<Matrix> covariance;        // of the position, m2
    std::optional<double> force, force_std;  // N, along the inward normal, only of a skin that is calibrated for it
    std::optional<double> pressure, area;    // Pa, the greatest; m2, force over pressure
    std::optional<bool> self_touch;          // whether another link of the robot touches here
};

// How fresh a patch's part is.
struct PatchState {
    std::string_view patch, frame;
    std::uint64_t sequence;     // of its newest cycle; 0 if it has not been heard of
    double time;                // its last sample (s, as now()); minus infinity likewise
    std::int64_t stamp;         // the same by the calendar (ns since 1970); 0 likewise
    std::array<char, 17> mode;  // its mode, ended by 0
    std::optional<double> total_force;  // of all contacts on it, by its auxiliary channel (N); none without a sound one
    double age() const { return now() - time; }
};

// The newest contacts of a skin, or of all skins of a robot.
struct Contacts {
    std::uint64_t sequence = 0;      // counts up by one with each; begins anew with `boot`
    std::uint64_t boot = 0;          // changes whenever the skin starts anew
    double time = 0;                 // last sample of the patch with the oldest data (s, as now())
    std::int64_t stamp = 0;          // the same by the calendar (ns since 1970)
    std::vector<PatchState> patches; // how fresh each patch is
    std::vector<PlacedContact> contacts;   // those of a patch strongest first
    double age() const { return now() - time; }  // seconds since then: a silent patch makes all of it old
};

namespace detail {

constexpr std::size_t kHead = 64, kSlot = 16, kSlots = 8;
constexpr double kLookAgain = 0.05;  // seconds without anything new after which a reader looks for a new board

inline std::uint32_t crc32(const void* data, std::size_t size, std::uint32_t crc = 0) {  // as zlib has it, continued
    static const auto table = [] {
        std::array<std::uint32_t, 256> made{};
        for (std::uint32_t i = 0; i < 256; ++i) {
            made[i] = i;
            for (int bit = 0; bit < 8; ++bit) made[i] = (made[i] & 1 ? 0xEDB88320u : 0u) ^ (made[i] >> 1);
        }
        return made;
    }();
    const auto* byte = static_cast<const unsigned char*>(data);
    for (crc = ~crc; size--; ++byte) crc = table[(crc ^ *byte) & 0xFF] ^ (crc >> 8);
    return ~crc;
}

struct Unmap { void operator()(char* memory) const { munmap(memory, size); } std::size_t size; };

template <class T>
T read(const char*& at) {
    T value;
    std::memcpy(&value, at, sizeof value);
    at += sizeof value;
    return value;
}

inline std::string folder() {
    const char *given = std::getenv("OHMSKIN_BOARDS"), *other = std::getenv("TMPDIR");
    if (given && *given) return given;
    const bool memory = access("/dev/shm", W_OK) == 0;
    return (memory ? "/dev/shm" : other && *other ? other : "/tmp") + ("/ohmskin-" + std::to_string(getuid()));
}

// The texts and numbers of JSON as Python writes it, by their paths: "/patches/0/name".
struct Json {
    explicit Json(std::string_view text) : in(std::string(text)) {
        in.imbue(std::locale::classic());
        value("", 0);
    }
    void value(const std::string& path, int depth) {
        const int kind = next(), end = kind == '{' ? '}' : ']';
        if (kind == '{' || kind == '[') {
            take(depth < 32 ? kind : 0);
            for (int count = 0; next() != end; ++count) {
                std::string key = std::to_string(count);
                if (count) take(',');
                if (kind == '{') key = text(), take(':');
                value(path + "/" + key, depth + 1);
            }
            take(end);
        } else if (kind == '"') {
            texts[path] = text();
        } else if (kind == '-' || std::isdigit(kind)) {
            in >> numbers[path];
        } else {
            while (std::isalpha(in.peek())) texts[path] += char(in.get());
        }
    }
    int next() { return (in >> std::ws).peek(); }
    static void check(bool right) { if (!right) throw std::out_of_range("no JSON"); }
    void take(int wanted) { check((in >> std::ws).get() == wanted); }
    std::string text() {  // in UTF-8, without JSON's escapes
        constexpr std::string_view marks = "\"\\/bfnrt", meant = "\"\\/\b\f\n\r\t";
        std::string told;
        take('"');
        for (char c = 0; in.get(c) && c != '"';)
            if (c == '\\' && in.get(c)) told += c == 'u' ? utf8(unit()) : std::string(1, meant.at(marks.find(c)));
            else told += c;
        return check(bool(in)), told;
    }
    std::uint32_t unit() {  // of UTF-16, four hexadecimal digits
        char digits[5] = {};
        check(in.read(digits, 4) && std::strspn(digits, "0123456789abcdefABCDEF") == 4);
        return std::uint32_t(std::strtoul(digits, nullptr, 16));
    }
    std::string utf8(std::uint32_t code) {
        if (code >> 10 == 0xD800 >> 10)  // whose other half follows
            take('\\'), take('u'), code = 0x10000 + ((code & 0x3FF) << 10 | (unit() & 0x3FF));
        const int more = (code >= 0x80) + (code >= 0x800) + (code >= 0x10000);
        std::string told(1, char(more ? 0x780 >> more | code >> 6 * more : code));
        for (int k = more; k--;) told += char(0x80 | (code >> 6 * k & 0x3F));
        return told;
    }
    Vector vector(const std::string& path) const {
        return {numbers.at(path + "/0"), numbers.at(path + "/1"), numbers.at(path + "/2")};
    }
    std::istringstream in;
    std::map<std::string, std::string> texts;
    std::map<std::string, double> numbers;
};

}  // namespace detail

// The newest message of one writer, in shared memory. It need not be there yet, and may go and come again.
class Board {
  public:
    explicit Board(const std::string& name) : folder_(detail::folder()), path_(folder_ + "/" + name) {
        const char* allowed = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_.";
        if (name.find_first_not_of(allowed) != name.npos || name.size() > 98 || name[0] <= '9' || name[0] == '_')
            throw Error("'" + name + "' cannot name what a skin publishes");
    }
    // The newest message, once, there until the next call; empty if there is none not given before. Never waits.
    std::string_view newest() {
        if (!memory_ || word(5) == number_) {
            const double at = now();
            if (at < look_at_) return {};
            look_at_ = at + detail::kLookAgain;
            open();
        }
        for (std::size_t tries = 0; memory_ && tries < detail::kSlots; ++tries) {
            const std::uint64_t number = word(5);
            if (number == number_) break;
            const char* at = memory_.get() + slots_at_ + number % detail::kSlots * slot_bytes_;
            const auto stated = detail::read<std::uint64_t>(at);
            const auto length = detail::read<std::uint32_t>(at);
            const auto checksum = detail::read<std::uint32_t>(at);
            if (stated != number || length > slot_bytes_ - detail::kSlot) continue;
            std::memcpy(copy_.data(), at, length);  // what is written meanwhile, the checksum tells
            if (detail::crc32(copy_.data(), length, detail::crc32(&number, sizeof number)) != checksum) continue;
            number_ = number, look_at_ = now() + detail::kLookAgain;
            return {copy_.data(), length};
        }
        return {};  // nothing new, or the writer overtook us time and again: it will be here at the next look
    }
    std::uint64_t boot() const { return memory_ ? word(4) : 0; }  // changes when the writer starts anew; 0 for no board
    bool closed() const { return !memory_ || word(6); }           // whether there is none, or its writer has ended
    const std::string& path() const { return path_; }
    std::string_view setup() const { return setup_; }             // what the writer said about itself, JSON

  private:
    std::uint64_t word(std::size_t which) const {
        return __atomic_load_n(reinterpret_cast<const std::uint64_t*>(memory_.get()) + which, __ATOMIC_ACQUIRE);
    }
    void open() {  // take the board that has the name now, if it is another one than before
        struct stat found {};
        if (lstat(folder_.c_str(), &found) != 0) return;
        if (!S_ISDIR(found.st_mode) || found.st_uid != getuid() || (found.st_mode & 077))
            throw Error(folder_ + " must be a folder that only you may use (chmod 700), or set OHMSKIN_BOARDS");
        const int file = ::open(path_.c_str(), O_RDONLY | O_NOFOLLOW | O_CLOEXEC);
        if (file < 0 && errno == ENOENT) return;
        if (file < 0) throw Error("cannot read " + path_ + ": " + std::strerror(errno) + "; check its owner");
        const bool stated = fstat(file, &found) == 0;
        const std::pair identity(found.st_dev, found.st_ino);
        const auto size = std::size_t(found.st_size);
        const bool same = memory_ && identity == identity_, fits = stated && size > detail::kHead && size <= 64u << 20;
        void* memory = fits && !same ? mmap(nullptr, size, PROT_READ, MAP_SHARED, file, 0) : MAP_FAILED;
        ::close(file);
        if (same) return;
        std::array<std::uint64_t, 8> head{};
        if (memory != MAP_FAILED) std::memcpy(head.data(), memory, sizeof head);
        const auto [magic, slots_at, slots, slot_bytes, boot, newest, ended, setup] = head;
        if (std::memcmp(&magic, "ohmskin2", 8) != 0 || slots != detail::kSlots || slot_bytes <= detail::kSlot ||
            slot_bytes > size || slots_at > size || slots_at + slots * slot_bytes != size || setup > size ||
            detail::kHead + setup > slots_at) {
            if (memory != MAP_FAILED) munmap(memory, size);
            throw Error(path_ + " is not of the version that this ohmskin.hpp reads; compile with the header of "
                                "the ohmskin that writes it (python -m ohmskin.client)");
        }
        memory_ = {static_cast<char*>(memory), {size}};
        slots_at_ = slots_at, slot_bytes_ = slot_bytes, number_ = 0;
        setup_ = {memory_.get() + detail::kHead, setup}, identity_ = identity;
        copy_.resize(slot_bytes);
    }
    std::string folder_, path_;
    std::unique_ptr<char, detail::Unmap> memory_{nullptr, {0}};
    std::size_t slots_at_ = 0, slot_bytes_ = 0;
    std::string_view setup_;
    std::pair<dev_t, ino_t> identity_;
    std::uint64_t number_ = 0;
    double look_at_ = -1;
    std::vector<char> copy_;
};

// What a skin, or a body of several, feels; `name` is what `ohmskin live --name` gave it. That nobody publishes is no
// error: look at the age. Both calls throw Error if the board is of another version; what they give is there until the
// next call.
class Client {
  public:
    explicit Client(const std::string& name = "skin") : board_(name) {
        newest_.patches.reserve(64), newest_.contacts.reserve(256);
    }
    // The newest contacts, returned before or not; null before there is anything. Never waits.
    const Contacts* newest() { return look(), newest_.boot ? &newest_ : nullptr; }
    // The next that was not given before; null if nothing comes within so many seconds.
    const Contacts* wait(double timeout) {
        const timespec nap{0, 100'000};  // a look takes some 30 ns
        for (const double end = now() + timeout; !look(); nanosleep(&nap, nullptr))
            if (now() >= end) return nullptr;
        return &newest_;
    }
    // The patches that the board tells of; null before there is one.
    const std::vector<Patch>* patches() const { return patch_lists_.empty() ? nullptr : &patch_lists_.back(); }

  private:
    bool look() {
        const std::string_view record = board_.newest();
        if (record.empty()) return false;
        if (board_.boot() != returned_boot_) learn();
        const char* at = record.data();
        std::uint32_t n[2] = {}, which = 0;  // patches and contacts; the patch of a contact
        if (record.size() >= 32) std::memcpy(n, at + 24, sizeof n);
        const std::size_t contacts_at = 32 + 48 * std::size_t{n[0]}, contact_bytes = 208;
        bool right = n[0] == patch_lists_.back().size() && record.size() == contacts_at + n[1] * contact_bytes;
        for (std::size_t i = 0; right && i < n[1]; ++i, right = which < n[0])
            std::memcpy(&which, at + contacts_at + i * contact_bytes, sizeof which);
        if (!right) throw Error("a record on " + board_.path() + " cannot be read; is its writer of another version?");
        newest_.boot = returned_boot_, newest_.sequence = detail::read<std::uint64_t>(at);
        newest_.time = detail::read<double>(at), newest_.stamp = detail::read<std::int64_t>(at), at += sizeof n;
        newest_.patches.clear(), newest_.contacts.clear();
        for (const Patch& patch : patch_lists_.back()) {
            PatchState& seen = newest_.patches.emplace_back(PatchState{patch.name, patch.frame, 0, 0, 0, {}, {}});
            seen.sequence = detail::read<std::uint64_t>(at), seen.time = detail::read<double>(at);
            seen.stamp = detail::read<std::int64_t>(at), std::memcpy(seen.mode.data(), at, 16), at += 16;
            if (const double total = detail::read<double>(at); !std::isnan(total)) seen.total_force = total;
        }
        for (std::uint32_t i = 0; i < n[1]; ++i) newest_.contacts.push_back(contact(at));
        return true;
    }
    PlacedContact contact(const char*& at) {
        const Patch& patch = patch_lists_.back()[detail::read<std::uint32_t>(at)];
        PlacedContact c{};
        c.id = detail::read<std::int32_t>(at), c.patch = patch.name, c.frame = patch.frame;
        const auto v = detail::read<std::array<double, 25>>(at);  // in the order of `ohmskin.client.fields`
        const auto maybe = [&v](std::size_t i) { return std::isnan(v[i]) ? std::nullopt : std::optional(v[i]); };
        c.position = {v[0], v[1], v[2]}, c.normal = {v[3], v[4], v[5]};
        c.extent = v[6], c.strength = v[7], c.confidence = v[8], c.peak = v[9], c.radius = maybe(10);
        if (!std::isnan(v[11])) c.velocity = {v[11], v[12], v[13]};
        if (!std::isnan(v[14])) c.covariance = {{{v[14], v[15], v[16]}, {v[15], v[17], v[18]}, {v[16], v[18], v[19]}}};
        c.force = maybe(20), c.force_std = maybe(21), c.pressure = maybe(22), c.area = maybe(23);
        if (!std::isnan(v[24])) c.self_touch = v[24] != 0;
        return c;
    }
    void learn() try {  // what a board of a new boot tells of its patches
        const detail::Json setup(board_.setup());
        std::vector<Patch> patches;
        for (std::string at; setup.texts.count((at = "/patches/" + std::to_string(patches.size())) + "/name");) {
            const Matrix axes{setup.vector(at + "/axes/0"), setup.vector(at + "/axes/1"), setup.vector(at + "/axes/2")};
            const bool newtons = setup.texts.count(at + "/newtons") && setup.texts.at(at + "/newtons") == "true";
            patches.push_back({setup.texts.at(at + "/name"), setup.texts.at(at + "/frame"),
                               setup.vector(at + "/position"), axes, newtons});
        }
        patch_lists_.push_back(std::move(patches)), returned_boot_ = board_.boot();
    } catch (const std::out_of_range&) {
        throw Error("the setup of " + board_.path() + " lacks its patches; is its writer of another version?");
    }
    Board board_;
    Contacts newest_;
    std::uint64_t returned_boot_ = 0;
    std::list<std::vector<Patch>> patch_lists_;  // of every boot, as contacts name them
};

}  // namespace ohmskin
