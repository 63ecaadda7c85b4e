// Drives ohmskin.hpp for tests/test_cpp_client.py; answers are lines of fields with tabs between, numbers exact (%a).
//   flood NAME     reads raw messages of a board until its writer ends, and holds each against its number
//   client NAME    then for each line on standard input, `newest` or `wait SECONDS`: what is felt, ended by a point
#include <cstdio>
#include <iostream>
#include <new>

#include "ohmskin.hpp"

static long allocations = 0;
void* operator new(std::size_t size) {
    ++allocations;
    if (void* memory = std::malloc(size)) return memory;
    throw std::bad_alloc();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

static void put(double value) { std::printf("\t%a", value); }
static void put(const ohmskin::Vector& vector) {
    for (double value : vector) put(value);
}
static void put(const std::optional<double>& value) { put(value.value_or(NAN)); }
static void put(std::string_view text) {  // a control character as the four characters \x09
    std::putchar('\t');
    for (char one : text) std::printf(one >= 0 && one < ' ' ? "\\x%02x" : "%c", one);
}

static void print(const ohmskin::Client& client, const ohmskin::Contacts& newest, long taken) {
    std::printf("felt\t%llu\t%llu\t%lld\t%ld", (unsigned long long)newest.sequence, (unsigned long long)newest.boot,
                (long long)newest.stamp, taken);
    put(newest.time), put(newest.age());
    for (const ohmskin::Patch& patch : *client.patches()) {
        std::printf("\npatch"), put(patch.name), put(patch.frame), put(double(patch.newtons)), put(patch.position);
        for (const ohmskin::Vector& axis : patch.axes) put(axis);
    }
    for (const ohmskin::PatchState& seen : newest.patches) {
        std::printf("\nseen"), put(seen.patch), put(seen.frame), put(seen.mode.data()), put(seen.time);
        std::printf("\t%llu\t%lld", (unsigned long long)seen.sequence, (long long)seen.stamp);
        put(seen.total_force);
    }
    for (const ohmskin::PlacedContact& c : newest.contacts) {
        std::printf("\ncontact"), put(c.patch), put(c.frame), put(c.id), put(c.position), put(c.normal);
        put(c.extent), put(c.strength), put(c.confidence), put(c.peak), put(c.radius);
        put(c.velocity.value_or(ohmskin::Vector{NAN, NAN, NAN}));
        for (std::size_t i = 0; i < 3; ++i)
            for (std::size_t j = i; j < 3; ++j) put(c.covariance ? (*c.covariance)[j][i] : NAN);  // the lower triangle
        put(c.force), put(c.force_std), put(c.pressure), put(c.area), put(c.self_touch ? *c.self_touch : NAN);
    }
}

static int flood(const char* name) {
    ohmskin::Board board(name);
    std::uint64_t last = 0, seen = 0;
    while (!last || !board.closed()) {
        const std::string_view message = board.newest();
        if (message.empty()) continue;
        std::uint64_t number = 0;
        std::memcpy(&number, message.data(), 8);
        if (number <= last || message.size() != 8 + number * 7 % 5900) return 1;
        for (char byte : message.substr(8))
            if (static_cast<unsigned char>(byte) != number % 251) return 2;
        last = number, ++seen;
    }
    std::printf("%llu %llu\n", (unsigned long long)last, (unsigned long long)seen);
    return 0;
}

int main(int, char** arguments) try {
    if (arguments[1] == std::string_view("flood")) return flood(arguments[2]);
    ohmskin::Client client(arguments[2]);
    for (std::string command; std::cin >> command; std::cout << "\n." << std::endl) try {
        double seconds = 0;
        if (command == "wait") std::cin >> seconds;
        const long before = allocations;
        const ohmskin::Contacts* newest = seconds > 0 ? client.wait(seconds) : client.newest();
        const long taken = allocations - before;
        if (newest) print(client, *newest, taken);
    } catch (const ohmskin::Error& error) {
        std::printf("error\t%s", error.what());
    }
} catch (const ohmskin::Error& error) {
    std::printf("%s\n", error.what());
    return 3;
}
