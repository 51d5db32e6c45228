// A client in C++ in a process of its own: set a spring, enable, receive a second of ticks, and say
// how far the handle moved. Commands and replies are JSON, telemetry is msgpack.
//
//   c++ -std=c++17 -o acquire acquire.cpp -lzmq          (Debian: libzmq3-dev cppzmq-dev libmsgpack-cxx-dev)
//   ./acquire "$(hapticd status --json | jq -r .endpoints.command)" tcp://127.0.0.1:9872
#include <algorithm>
#include <chrono>
#include <iostream>
#include <stdexcept>
#include <string>

#include <msgpack.hpp>
#include <zmq.hpp>

// The reply to one request; a refusal, or no reply within two seconds, is an exception.
static std::string ask(zmq::socket_t &socket, const std::string &request) {
    socket.send(zmq::buffer(request), zmq::send_flags::none);
    zmq::message_t reply;
    if (!socket.recv(reply, zmq::recv_flags::none))
        throw std::runtime_error("no reply to " + request + "; is `hapticd run` running?");
    const std::string text = reply.to_string();
    if (text.find("\"ok\":true") == std::string::npos && text.find("\"ok\": true") == std::string::npos)
        throw std::runtime_error(text);
    return text;
}

static double number(const msgpack::object_map &record, const std::string &name) {
    for (const auto *field = record.ptr; field != record.ptr + record.size; ++field)
        if (field->key.as<std::string>() == name)
            return field->val.as<double>();
    throw std::runtime_error("no field " + name);
}

int main(int count, char **words) {
    if (count != 3) {
        std::cerr << "usage: acquire COMMAND-ENDPOINT TELEMETRY-ENDPOINT\n";
        return 2;
    }
    try {
        zmq::context_t context;
        zmq::socket_t commands(context, zmq::socket_type::req);
        commands.set(zmq::sockopt::rcvtimeo, 2000);
        commands.set(zmq::sockopt::linger, 0);
        commands.connect(words[1]);
        zmq::socket_t telemetry(context, zmq::socket_type::sub);
        telemetry.set(zmq::sockopt::rcvtimeo, 2000);
        telemetry.set(zmq::sockopt::linger, 0);
        telemetry.set(zmq::sockopt::subscribe, "servo");
        telemetry.connect(words[2]);

        ask(commands, R"({"cmd": "hello", "id": 1, "name": "acquire"})");
        ask(commands, R"({"cmd": "set", "id": 2, "K": 100, "B": 1})");
        ask(commands, R"({"cmd": "enable", "id": 3})");
        int ticks = 0;
        double lowest = 1e9;
        double highest = -1e9;
        while (ticks < 1000) {
            zmq::message_t topic;
            zmq::message_t payload;
            if (!telemetry.recv(topic) || !telemetry.recv(payload))
                throw std::runtime_error("telemetry is silent");
            if (topic.to_string() != "servo")  // ZeroMQ matches prefixes: servo.raw may come too
                continue;
            const auto unpacked = msgpack::unpack(payload.data<char>(), payload.size());
            const auto records = unpacked.get().via.array;  // a map for each tick
            const auto *end = records.ptr + records.size;
            for (const auto *one = records.ptr; one != end && ticks < 1000; ++one, ++ticks) {
                const double x_m = number(one->via.map, "position_m");
                lowest = std::min(lowest, x_m);
                highest = std::max(highest, x_m);
            }
        }
        ask(commands, R"({"cmd": "disable", "id": 4})");
        std::cout << ticks << " ticks, from " << 1e3 * lowest << " to " << 1e3 * highest << " mm\n";
    } catch (const std::exception &error) {
        std::cerr << "acquire: " << error.what() << "\n";
        return 1;
    }
}
