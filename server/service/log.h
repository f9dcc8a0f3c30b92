// Log lines with fields, and with the call that they are about.

#ifndef SERVER_SERVICE_LOG_H_
#define SERVER_SERVICE_LOG_H_

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "spdlog/common.h"
#include "spdlog/formatter.h"

namespace deltaray {

enum class LogFormat : uint8_t { kText, kJson };

// What makes a line of a message: `[time] [logger] [level] message field=value ...`, or an object of JSON. Whatever
// clients put into a message or a field, it stays one line: bytes that are no UTF-8 and control characters become
// U+FFFD.
std::unique_ptr<spdlog::formatter> MakeLogFormatter(LogFormat format);

// Has the messages of gRPC and protobuf logged as ours are; of gRPC's errors, ten a second.
void TakeLibraryLogs();

using LogValue = std::variant<std::string_view, int64_t, double>;
using LogFields = std::vector<std::pair<std::string_view, LogValue>>;

// Logs `message` with `fields`.
void LogEvent(spdlog::level::level_enum level, std::string_view message, const LogFields& fields);

// While it lives, all that its thread logs is marked with the request id of a call. Scopes nest; used by one thread.
class LogScope {
 public:
  // `request_id` outlives the scope.
  explicit LogScope(std::string_view request_id);
  ~LogScope();
  LogScope(const LogScope&) = delete;
  LogScope& operator=(const LogScope&) = delete;

 private:
  const std::string_view outer_;
};

}  // namespace deltaray

#endif  // SERVER_SERVICE_LOG_H_
