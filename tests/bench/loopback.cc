#include "tests/bench/loopback.h"

#include <boost/asio/buffer.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/read.hpp>
#include <boost/asio/write.hpp>
#include <thread>
#include <vector>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "tests/bench/measure.h"

namespace deltaray {

absl::StatusOr<double> MoveOverLoopback(size_t request_bytes, size_t reply_bytes, size_t count) {
  using boost::asio::ip::tcp;
  try {
    boost::asio::io_context context;
    tcp::acceptor acceptor(context, tcp::endpoint(boost::asio::ip::address_v4::loopback(), 0));
    tcp::socket client(context);
    client.connect(acceptor.local_endpoint());
    tcp::socket server = acceptor.accept();
    for (tcp::socket* const socket : {&client, &server}) socket->set_option(tcp::no_delay(true));

    const std::vector<char> request(request_bytes), reply(reply_bytes);
    std::vector<char> received_request(request_bytes), received_reply(reply_bytes);
    const double start = ProcessCpuSeconds();
    // Who meets an error shuts the connection, which ends all three.
    const auto shut = [](tcp::socket& socket) {
      boost::system::error_code ignored;
      socket.shutdown(tcp::socket::shutdown_both, ignored);
    };
    boost::system::error_code write_error, server_error, read_error;
    std::thread writing([&] {
      for (size_t i = 0; i < count && !write_error; ++i) write(client, boost::asio::buffer(request), write_error);
      if (write_error) shut(client);
    });
    std::thread serving([&] {
      for (size_t i = 0; i < count && !server_error; ++i) {
        read(server, boost::asio::buffer(received_request), server_error);
        if (!server_error) write(server, boost::asio::buffer(reply), server_error);
      }
      if (server_error) shut(server);
    });
    for (size_t i = 0; i < count && !read_error; ++i) read(client, boost::asio::buffer(received_reply), read_error);
    if (read_error) shut(client);
    writing.join();
    serving.join();
    for (const boost::system::error_code& error : {write_error, server_error, read_error}) {
      if (error) return absl::UnavailableError(absl::StrCat("loopback: ", error.message()));
    }
    return ProcessCpuSeconds() - start;
  } catch (const boost::system::system_error& error) {
    return absl::UnavailableError(absl::StrCat("loopback: ", error.what()));
  }
}

}  // namespace deltaray
