#include "server/service/log.h"

#include <grpc/support/log.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <ctime>

#include "absl/strings/str_cat.h"
#include "absl/strings/string_view.h"
#include "google/protobuf/stubs/logging.h"
#include "server/build/mutex.h"
#include "server/mesh/utf8.h"
#include "spdlog/pattern_formatter.h"
#include "spdlog/spdlog.h"

namespace deltaray {
namespace {

// What the formatter, which runs on the thread that logs, adds to the message.
thread_local std::string_view current_request_id;
thread_local const LogFields* current_fields = nullptr;

absl::string_view View(std::string_view text) { return {text.data(), text.size()}; }

// In quotes, as JSON writes it.
std::string Quoted(std::string_view text) {
  std::string quoted = "\"";
  for (const char c : ToValidUtf8(View(text))) {
    if (c == '"' || c == '\\') quoted += '\\';
    quoted += c;
  }
  return quoted += '"';
}

std::string ValueText(const LogValue& value) {
  if (const auto* text = std::get_if<std::string_view>(&value)) return Quoted(*text);
  if (const auto* number = std::get_if<int64_t>(&value)) return absl::StrCat(*number);
  return absl::StrCat(std::get<double>(value));
}

// The message, the fields and the request id: `message field=value`, or `"message":"...","field":value`.
class MessageFlag final : public spdlog::custom_flag_formatter {
 public:
  explicit MessageFlag(LogFormat format) : format_(format) {}

  void format(const spdlog::details::log_msg& message, const std::tm&, spdlog::memory_buf_t& line) override {
    const std::string_view payload(message.payload.data(), message.payload.size());
    std::string text =
        format_ == LogFormat::kJson ? absl::StrCat("\"message\":", Quoted(payload)) : ToValidUtf8(View(payload));
    if (current_fields != nullptr) {
      for (const auto& [name, value] : *current_fields) Append(name, value, &text);
    }
    if (!current_request_id.empty()) Append("request_id", current_request_id, &text);
    line.append(text.data(), text.data() + text.size());
  }

  std::unique_ptr<custom_flag_formatter> clone() const override { return std::make_unique<MessageFlag>(format_); }

 private:
  void Append(std::string_view name, const LogValue& value, std::string* text) const {
    if (format_ == LogFormat::kJson) {
      absl::StrAppend(text, ",", Quoted(name), ":", ValueText(value));
    } else {
      absl::StrAppend(text, " ", View(name), "=", ValueText(value));
    }
  }

  const LogFormat format_;
};

// gRPC calls an error what any client can bring about, as a handshake that fails: whoever sends many shall not fill the
// log. Of a second, so many lines are logged; the first one of a later second tells how many were not. Other levels are
// there only where GRPC_VERBOSITY asks for them.
constexpr uint64_t kGrpcErrorsPerSecond = 10;

// Whether another one may be logged.
bool MayLogGrpcError() {
  static Mutex mutex;
  static int64_t second = 0;
  static uint64_t count = 0;
  uint64_t left_out = 0;
  {
    MutexLock lock(mutex);
    const int64_t now =
        std::chrono::duration_cast<std::chrono::seconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
    if (now != second) {
      left_out = count - std::min(count, kGrpcErrorsPerSecond);
      second = now;
      count = 0;
    }
    if (++count > kGrpcErrorsPerSecond) return false;
  }
  if (left_out > 0) spdlog::error("gRPC: {} more errors were left out", left_out);
  return true;
}

void LogOfGrpc(gpr_log_func_args* args) {
  if (args->severity == GPR_LOG_SEVERITY_ERROR && !MayLogGrpcError()) return;
  const auto level = args->severity == GPR_LOG_SEVERITY_ERROR  ? spdlog::level::err
                     : args->severity == GPR_LOG_SEVERITY_INFO ? spdlog::level::info
                                                               : spdlog::level::debug;
  spdlog::log(level, "gRPC: {}", args->message);
}

// Apart from what ends the process, protobuf only tells of messages that are malformed. Their senders are told so, and
// whoever sends many shall not fill the log.
void LogOfProtobuf(google::protobuf::LogLevel level, const char*, int, const std::string& message) {
  spdlog::log(level == google::protobuf::LOGLEVEL_FATAL ? spdlog::level::critical : spdlog::level::debug,
              "protobuf: {}", message);
}

}  // namespace

std::unique_ptr<spdlog::formatter> MakeLogFormatter(LogFormat format) {
  const bool json = format == LogFormat::kJson;
  auto formatter = std::make_unique<spdlog::pattern_formatter>(json ? spdlog::pattern_time_type::utc
                                                                    : spdlog::pattern_time_type::local);
  formatter->add_flag<MessageFlag>('*', format);
  formatter->set_pattern(json ? R"({"time":"%Y-%m-%dT%H:%M:%S.%eZ","level":"%l",%*})"
                              : "[%Y-%m-%d %H:%M:%S.%e] [%n] [%^%l%$] %*");
  return formatter;
}

void TakeLibraryLogs() {
  gpr_set_log_function(LogOfGrpc);
  google::protobuf::SetLogHandler(LogOfProtobuf);
}

void LogEvent(spdlog::level::level_enum level, std::string_view message, const LogFields& fields) {
  if (!spdlog::should_log(level)) return;
  const LogFields* const outer = current_fields;
  current_fields = &fields;
  spdlog::log(level, message);
  current_fields = outer;
}

LogScope::LogScope(std::string_view request_id) : outer_(current_request_id) { current_request_id = request_id; }

LogScope::~LogScope() { current_request_id = outer_; }

}  // namespace deltaray
