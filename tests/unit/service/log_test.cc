#include "server/service/log.h"

#include <grpc/support/log.h>

#include <algorithm>
#include <chrono>
#include <thread>

#include "deltaray/v1/mesh_service.pb.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "spdlog/spdlog.h"
#include "tests/unit/service/captured_log.h"

namespace deltaray {
namespace {

using testing::ContainsRegex;
using testing::EndsWith;
using testing::HasSubstr;
using testing::MatchesRegex;
using testing::Not;

TEST(LogTest, TextHasMessageFieldsAndRequestId) {
  CapturedLog log(LogFormat::kText);
  {
    const LogScope scope("abc-1");
    LogEvent(spdlog::level::info, "call", {{"method", "A/B"}, {"ms", 1.5}, {"rays", int64_t{7}}});
  }
  EXPECT_THAT(log.text(), EndsWith("[test] [info] call method=\"A/B\" ms=1.5 rays=7 request_id=\"abc-1\"\n"));
}

TEST(LogTest, JsonIsAnObjectALine) {
  CapturedLog log(LogFormat::kJson);
  LogEvent(spdlog::level::warn, "a \"quoted\" \\ text", {{"n", int64_t{-3}}, {"file", "a\"b"}});
  EXPECT_THAT(log.text(), MatchesRegex("\\{\"time\":\"20[0-9T:.-]*Z\",\"level\":\"warning\",\"message\":\"a "
                                       "\\\\\"quoted\\\\\" \\\\\\\\ text\",\"n\":-3,\"file\":\"a\\\\\"b\"\\}\n"));
}

TEST(LogTest, NothingThatAClientSendsMakesALine) {
  for (const LogFormat format : {LogFormat::kText, LogFormat::kJson}) {
    CapturedLog log(format);
    spdlog::info("named mesh {}", "x\n[2026-01-01 00:00:00.000] [deltarayd] [info] forged\r\x1b[2K\xff");
    LogEvent(spdlog::level::info, "call", {{"error", "y\nforged"}});
    const std::string text = log.text();
    EXPECT_EQ(std::count(text.begin(), text.end(), '\n'), 2) << text;
    EXPECT_THAT(text, Not(HasSubstr("\r")));
    EXPECT_THAT(text, Not(HasSubstr("\x1b")));
    EXPECT_THAT(text, Not(HasSubstr("\xff")));
  }
}

TEST(LogTest, ScopesNest) {
  CapturedLog log(LogFormat::kText);
  const LogScope outer("outer");
  { const LogScope inner("inner"); }
  spdlog::info("message");
  EXPECT_THAT(log.text(), HasSubstr("message request_id=\"outer\""));
}

// protobuf by itself writes to stderr for each message whose text is no UTF-8.
TEST(LogTest, MalformedMessagesAreForDebugging) {
  TakeLibraryLogs();
  CapturedLog log(LogFormat::kText);
  testing::internal::CaptureStderr();
  v1::GetMeshRequest request;
  EXPECT_FALSE(request.ParseFromString("\x0a\x01\xff"));
  EXPECT_EQ(testing::internal::GetCapturedStderr(), "");
  EXPECT_THAT(log.text(), HasSubstr("[debug] protobuf: "));
}

// Each handshake that fails, and each request that is compressed, is an error to gRPC.
TEST(LogTest, ErrorsOfGrpcAreFewASecond) {
  TakeLibraryLogs();
  gpr_set_log_verbosity(GPR_LOG_SEVERITY_ERROR);
  CapturedLog log(LogFormat::kText);
  const auto count = [&](const std::string& what) {
    const std::string text = log.text();
    size_t found = 0;
    for (size_t at = 0; (at = text.find(what, at)) != std::string::npos; ++at) ++found;
    return found;
  };
  for (int i = 0; i < 1000; ++i) gpr_log(GPR_ERROR, "refused");
  // They may fall into several seconds.
  const size_t seconds = 1 + count("left out");
  EXPECT_GE(count("gRPC: refused"), 1u);
  EXPECT_LE(count("gRPC: refused"), 10 * seconds);
  std::this_thread::sleep_for(std::chrono::milliseconds(1100));
  gpr_log(GPR_ERROR, "later");
  EXPECT_THAT(log.text(), ContainsRegex("gRPC: [0-9]+ more errors were left out\n.*gRPC: later"));
}

}  // namespace
}  // namespace deltaray
